"""The laws of contact: Signorini's and Coulomb's, exact, and how far contacts are from them.

With the motion w(lambda) = W lambda + q, for each contact

    0 <= w_n  _|_  lambda_n >= 0,    |lambda_t| <= mu lambda_n,    w_t != 0  =>  lambda_t = -mu lambda_n w_t / |w_t|,

which is  K  contains  lambda  _|_  w + mu |w_t| n  in  K*  with the Coulomb cone K (De Saxce). The residual is that of
the natural map, |lambda - Proj_K(lambda - (w + mu |w_t| n) / rho)| [N], largest over the contacts of a world.
Vectors of a contact are (normal, tangential, tangential). How the laws are solved: ``kernels_contact_solver``.
"""

import warp as wp

from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})

RHO_FRACTION = wp.constant(wp.float64(0.3))
ROUNDING = wp.constant(wp.float64(2.3e-16))
"""Of a number in double precision [-]: beside an enormous force, a motion against the law would not show."""


@wp.struct
class ContactProblems:
    """One frictional contact problem per row, over the contact points of a world."""

    worlds: wp.array[int]  # (row,)
    count: wp.array[int]  # (world,) points
    matrix: wp.array2d[mat33d]  # (world, place): upper half of W [m/N], positive semi-definite
    force: wp.array2d[vec3d]  # (row, contact): forces to begin with [N]
    motion: wp.array2d[vec3d]  # (row, contact): their motion w [m]
    friction: wp.float64  # mu [-]
    rho: wp.array[wp.float64]  # (world,): elastic self-compliance of a contact, scale of the natural map [m/N]


@wp.func
def tangential_length(v: vec3d) -> wp.float64:
    """Length of the tangential part."""
    return wp.sqrt(v[1] * v[1] + v[2] * v[2])


@wp.func
def project_on_cone(v: vec3d, friction: wp.float64) -> vec3d:
    """Return the point of the Coulomb cone |v_t| <= mu v_n closest to v."""
    t = tangential_length(v)
    if friction * t <= -v[0]:  # first, since without friction a v straight below the tip passes the next test, too
        return vec3d()
    if t <= friction * v[0]:
        return v
    n = (v[0] + friction * t) / (wp.float64(1.0) + friction * friction)
    scale = friction * n / t
    return vec3d(n, scale * v[1], scale * v[2])


@wp.func
def with_de_saxce(w: vec3d, friction: wp.float64) -> vec3d:
    """Return w + mu |w_t| n."""
    return vec3d(w[0] + friction * tangential_length(w), w[1], w[2])


@wp.func
def natural_map(force: vec3d, w: vec3d, rho: wp.float64, friction: wp.float64) -> wp.float64:
    """Return how far a contact is from its law [N], not less than rounding lets one know."""
    distance = wp.length(force - project_on_cone(force - with_de_saxce(w, friction) / rho, friction))
    return distance + ROUNDING * wp.length(force)


@wp.func
def largest_residual(
    force: wp.array2d[vec3d], motion: wp.array2d[vec3d], row: int, count: int, rho: wp.float64, friction: wp.float64
) -> wp.float64:
    """Distance of the worst contact of a row from its law [N]; not finite where a force or motion is not."""
    worst = wp.float64(0.0)
    for c in range(count):
        distance = natural_map(force[row, c], motion[row, c], rho, friction)
        if not wp.isfinite(distance):
            return distance
        worst = wp.max(worst, distance)
    return worst


@wp.kernel
def contact_residual(
    rows: Rows,
    count: wp.array[int],  # (world,)
    friction: wp.float64,
    rho: wp.array[wp.float64],  # (world,) [m/N]
    force: wp.array2d[vec3d],  # (row, contact) [N]
    motion: wp.array2d[vec3d],  # (row, contact) [m]
    residual_out: wp.array[wp.float64],  # (world,) [N]
):
    """Largest distance of a contact from its law."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    residual_out[w] = largest_residual(force, motion, i, count[w], rho[w], friction)


@wp.kernel
def estimate_rho(
    rows: Rows,
    count: wp.array[int],  # (world,)
    nodes: wp.array2d[wp.vec3i],  # (world, contact)
    weights: wp.array2d[vec3d],  # (world, contact)
    elastic: wp.array[wp.float64],  # (node,) [m/N]
    rho_out: wp.array[wp.float64],  # (world,) [m/N]
):
    """Scale of the natural map: a fraction of the mean elastic self-compliance of a world's contact points."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    total = wp.float64(0.0)
    for c in range(count[w]):
        for k in range(3):
            a = weights[w, c][k]
            total += a * a * elastic[nodes[w, c][k]]
    rho_out[w] = RHO_FRACTION * total / wp.float64(wp.max(count[w], 1))
