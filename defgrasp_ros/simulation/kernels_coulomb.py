"""Kernels of the contact problem: ADMM on Signorini's and Coulomb's exact laws.

Given w(lambda) = W lambda + q, find for each contact

    0 <= w_n  _|_  lambda_n >= 0,    |lambda_t| <= mu lambda_n,    w_t != 0  =>  lambda_t = -mu lambda_n w_t / |w_t|,

which is  K  contains  lambda  _|_  w + mu |w_t| n  in  K*  with the Coulomb cone K (De Saxce). Over-relaxed ADMM
with the scaled dual u, whose shift s is taken from the dual itself:

    x = (W + rho)^-1 (rho (z - u) - q - s),   s = (mu rho |u_t|, 0, 0)
    x' = a x + (1 - a) z,   z = Proj_K(x' + u),   u += x' - z.

The residual of a solution z is that of the natural map, |z - Proj_K(z - (w + mu |w_t| n) / rho)| [N].
"""

import warp as wp

from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

OVER_RELAXATION = wp.constant(wp.float64(1.5))
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


@wp.func
def admm_right_side(z: vec3d, u: vec3d, offset: vec3d, rho: wp.float64, friction: wp.float64) -> vec3d:
    """Return rho (z - u) - q - s."""
    shift = friction * rho * wp.sqrt(u[1] * u[1] + u[2] * u[2])
    return rho * (z - u) - offset - vec3d(shift, wp.float64(0.0), wp.float64(0.0))


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
    """ADMM's weight: a fraction of the mean elastic self-compliance of a world's contact points."""
    i = wp.tid()
    w = worlds[i]
    total = wp.float64(0.0)
    for c in range(count[w]):
        for k in range(3):
            a = weights[w, c][k]
            total += a * a * elastic[nodes[w, c][k]]
    rho_out[w] = RHO_FRACTION * total / wp.float64(wp.max(count[w], 1))


@wp.kernel
def admm_start(
    count: wp.array[int],  # (world,)
    worlds: wp.array[int],  # (row,)
    friction: wp.float64,
    rho: wp.array[wp.float64],  # (world,) [m/N]
    offset: wp.array2d[vec3d],  # (row, contact): q [m]
    force: wp.array2d[vec3d],  # (row, contact): first guess [N]
    motion: wp.array2d[vec3d],  # (row, contact): w of the first guess [m]
    # Out:
    z: wp.array2d[vec3d],  # (row, contact) [N]
    dual: wp.array2d[vec3d],  # (row, contact) [N]
    right_side: wp.array2d[vec3d],  # (row, contact) [m]
):
    """Start from the last forces, and from the dual that belongs to the predicted motion."""
    i, c = wp.tid()
    w = worlds[i]
    if c >= count[w]:
        return
    z[i, c] = project_on_cone(force[i, c], friction)
    dual[i, c] = -with_de_saxce(motion[i, c], friction) / rho[w]
    right_side[i, c] = admm_right_side(z[i, c], dual[i, c], offset[i, c], rho[w], friction)


@wp.kernel
def admm_project(
    count: wp.array[int],  # (world,)
    worlds: wp.array[int],  # (row,)
    done: wp.array[int],  # (row,)
    friction: wp.float64,
    rho: wp.array[wp.float64],  # (world,) [m/N]
    offset: wp.array2d[vec3d],  # (row, contact): q [m]
    x: wp.array2d[vec3d],  # (row, contact) [N]
    # In and out:
    z: wp.array2d[vec3d],  # (row, contact) [N]
    dual: wp.array2d[vec3d],  # (row, contact) [N]
    right_side: wp.array2d[vec3d],  # (row, contact) [m]
):
    """Second half of an iteration: relax, project, update the dual."""
    i, c = wp.tid()
    w = worlds[i]
    if done[i] != 0 or c >= count[w]:
        return
    relaxed = OVER_RELAXATION * x[i, c] + (wp.float64(1.0) - OVER_RELAXATION) * z[i, c]
    projected = project_on_cone(relaxed + dual[i, c], friction)
    u = dual[i, c] + relaxed - projected
    z[i, c] = projected
    dual[i, c] = u
    right_side[i, c] = admm_right_side(projected, u, offset[i, c], rho[w], friction)


@wp.kernel
def admm_check(
    count: wp.array[int],  # (world,)
    worlds: wp.array[int],  # (row,)
    friction: wp.float64,
    rho: wp.array[wp.float64],  # (world,) [m/N]
    tolerance: wp.array[wp.float64],  # (row,) [N]
    offset: wp.array2d[vec3d],  # (row, contact): q [m]
    z: wp.array2d[vec3d],  # (row, contact) [N]
    compliance_times_z: wp.array2d[vec3d],  # (row, contact): W z [m]
    # Out:
    done: wp.array[int],  # (row,)
):
    """Mark the worlds in which z obeys the contact laws."""
    i = wp.tid()
    w = worlds[i]
    if done[i] != 0:
        return
    for c in range(count[w]):
        if natural_map(z[i, c], compliance_times_z[i, c] + offset[i, c], rho[w], friction) > tolerance[i]:
            return
    done[i] = 1
