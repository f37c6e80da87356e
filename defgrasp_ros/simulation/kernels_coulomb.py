"""Kernels of the contact laws: how far the contacts of each world are from them. How they are solved: ``coulomb``."""

import warp as wp

from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

RHO_FRACTION = wp.constant(wp.float64(0.3))


@wp.func
def project_on_cone(v: vec3d, friction: wp.float64) -> vec3d:
    """Return the point of the Coulomb cone |v_t| <= mu v_n closest to v = (normal, tangential, tangential)."""
    t = wp.sqrt(v[1] * v[1] + v[2] * v[2])
    if t <= friction * v[0]:
        return v
    if friction * t <= -v[0]:
        return vec3d()
    n = (v[0] + friction * t) / (wp.float64(1.0) + friction * friction)
    scale = friction * n / t
    return vec3d(n, scale * v[1], scale * v[2])


@wp.func
def with_de_saxce(w: vec3d, friction: wp.float64) -> vec3d:
    """Return w + mu |w_t| n."""
    return vec3d(w[0] + friction * wp.sqrt(w[1] * w[1] + w[2] * w[2]), w[1], w[2])


@wp.func
def natural_map(force: vec3d, w: vec3d, rho: wp.float64, friction: wp.float64) -> wp.float64:
    """Return how far a contact is from its law [N]."""
    return wp.length(force - project_on_cone(force - with_de_saxce(w, friction) / rho, friction))


@wp.kernel
def contact_residual(
    count: wp.array[int],  # (world,)
    worlds: wp.array[int],  # (row,)
    friction: wp.float64,
    rho: wp.array[wp.float64],  # (world,) [m/N]
    force: wp.array2d[vec3d],  # (row, contact) [N]
    motion: wp.array2d[vec3d],  # (row, contact) [m]
    residual_out: wp.array[wp.float64],  # (row,) [N]
):
    """Largest distance of a contact from its law."""
    i = wp.tid()
    w = worlds[i]
    worst = wp.float64(0.0)
    for c in range(count[w]):
        worst = wp.max(worst, natural_map(force[i, c], motion[i, c], rho[w], friction))
    residual_out[i] = worst


@wp.kernel
def estimate_rho(
    count: wp.array[int],  # (world,)
    nodes: wp.array2d[wp.vec3i],  # (world, contact)
    weights: wp.array2d[vec3d],  # (world, contact)
    elastic: wp.array[wp.float64],  # (node,) [m/N]
    worlds: wp.array[int],  # (row,)
    rho_out: wp.array[wp.float64],  # (world,) [m/N]
):
    """Scale of the natural map: a fraction of the mean elastic self-compliance of a world's contact points."""
    i = wp.tid()
    w = worlds[i]
    total = wp.float64(0.0)
    for c in range(count[w]):
        for k in range(3):
            a = weights[w, c][k]
            total += a * a * elastic[nodes[w, c][k]]
    rho_out[w] = RHO_FRACTION * total / wp.float64(wp.max(count[w], 1))
