"""The function of Alart and Curnier (1991), whose roots obey the laws of contact, and its slope.

    Phi(lambda) = lambda - (max(0, n), P_disk(t)),   (n, t) = lambda - w / r,   radius of the disk: mu max(0, n).

The scale r [m/N] sets the path of a method that looks for a root, not the root.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_coulomb import tangential_length
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})


@wp.func
def alart_curnier(trial: vec3d, friction: wp.float64) -> vec3d:
    """Return (max(0, n), projection of t on the disk of radius mu max(0, n)) [N]."""
    if trial[0] <= wp.float64(0.0):
        return vec3d()
    radius = friction * trial[0]
    t = tangential_length(trial)
    if t <= radius:
        return trial
    share = radius / t
    return vec3d(trial[0], share * trial[1], share * trial[2])


@wp.func
def alart_curnier_slope(trial: vec3d, friction: wp.float64) -> mat33d:
    """Return an element of the generalised Jacobian of ``alart_curnier``: 0 where open, 1 where sticking."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    if trial[0] <= zero:
        return mat33d()
    radius = friction * trial[0]
    t = tangential_length(trial)
    if radius == zero:
        return mat33d(one, zero, zero, zero, zero, zero, zero, zero, zero)
    if t <= radius:
        return mat33d(one, zero, zero, zero, one, zero, zero, zero, one)
    x = trial[1] / t
    y = trial[2] / t
    share = radius / t
    return mat33d(
        one,
        zero,
        zero,
        friction * x,
        share * (one - x * x),
        -share * x * y,
        friction * y,
        -share * x * y,
        share * (one - y * y),
    )


@wp.func
def phi(force: vec3d, motion: vec3d, scale: wp.float64, friction: wp.float64) -> vec3d:
    """Return Phi [N] of one contact."""
    return force - alart_curnier(force - motion / scale, friction)
