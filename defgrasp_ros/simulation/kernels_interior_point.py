"""A primal-dual interior point method for contact problems with friction; slow, but it needs no good first guess.

With x = (mu lambda_n, lambda_t) and z = (w_n / mu + |w_t|, w_t) the laws of contact say that both lie in the cone
|t| <= n, at a right angle (Acary, Armand, Nguyen and Shpakovych 2023):

    z = M x + p + |z_t| n,    x in cone,  z in cone,  x . z = 0,      M = D^-1 W D^-1,  p = D^-1 q,  D = diag(mu, 1, 1).

Each iteration takes a step of Newton's method towards x o z = sigma mu_c e (o is the product of the cone's Jordan
algebra, mu_c the mean of x . z), scaled after Nesterov and Todd: dz = sigma mu_c x^-1 - z - H dx with H x = z, so that

    (M + J H) dx = J (sigma mu_c x^-1 - z) - (M x + p + |z_t| n - z),      J = 1 - n (z_t / |z_t|)^T.

The term |z_t| n makes the problem not convex: near-rigid bodies can stop the method early, then its best iterate is a
first guess for Newton's method of its own.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_block_matrix import (
    block_of_symmetric,
    factorise,
    multiply_symmetric,
    solve_factorised,
)
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems, largest_residual, tangential_length
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})

MAX_ITERATIONS = wp.constant(60)
FIRST_GAP = wp.constant(wp.float64(0.3))
"""First z relative to the largest motion without forces [-]."""
BOUNDARY_SHARE = wp.constant(wp.float64(0.95))
"""Part of the way to the boundary of the cones that a step goes [-]."""
LEAST_CENTRING = wp.constant(wp.float64(0.01))
MOST_CENTRING = wp.constant(wp.float64(0.9))
LARGEST = wp.constant(wp.float64(1e300))


@wp.struct
class InteriorPointBuffers:
    """Work space, one row per problem."""

    offset: wp.array2d[vec3d]  # (row, contact): q [m]
    x: wp.array2d[vec3d]  # (row, contact): scaled forces [N]
    z: wp.array2d[vec3d]  # (row, contact): scaled motions [m]
    missing: wp.array2d[vec3d]  # (row, contact): M x + p + |z_t| n - z [m]
    dx: wp.array2d[vec3d]  # (row, contact)
    dz: wp.array2d[vec3d]  # (row, contact)
    force: wp.array2d[vec3d]  # (row, contact): x as forces [N]
    motion: wp.array2d[vec3d]  # (row, contact): their w [m]
    best: wp.array2d[vec3d]  # (row, contact): forces with the least residual [N]
    system: wp.array3d[mat33d]  # (world, contact, contact): M + J H


@wp.func
def mirrored(v: vec3d) -> vec3d:
    """Return (n, -t)."""
    return vec3d(v[0], -v[1], -v[2])


@wp.func
def determinant(v: vec3d) -> wp.float64:
    """Return n^2 - |t|^2, positive inside the cone."""
    t = tangential_length(v)
    return (v[0] - t) * (v[0] + t)


@wp.func
def inverse_in_cone(v: vec3d) -> vec3d:
    """Return the inverse in the cone's Jordan algebra."""
    return mirrored(v) / determinant(v)


@wp.func
def scaling(x: vec3d, z: vec3d) -> mat33d:
    """Return the symmetric, positive definite H of Nesterov and Todd with H x = z."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    det_x = wp.sqrt(determinant(x))
    det_z = wp.sqrt(determinant(z))
    unit_x = x / det_x
    unit_z = z / det_z
    gamma = wp.sqrt((one + wp.dot(unit_x, unit_z)) / two)
    v = (unit_z + mirrored(unit_x)) / (two * gamma)
    h = two * wp.outer(v, v)
    h[0, 0] = h[0, 0] - one
    h[1, 1] = h[1, 1] + one
    h[2, 2] = h[2, 2] + one
    return h * (det_z / det_x)


@wp.func
def shift_jacobian(z: vec3d) -> mat33d:
    """Return J = 1 - n (z_t / |z_t|)^T."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    t = tangential_length(z)
    if t == zero:
        return mat33d(one, zero, zero, zero, one, zero, zero, zero, one)
    return mat33d(one, -z[1] / t, -z[2] / t, zero, one, zero, zero, zero, one)


@wp.func
def step_to_boundary(v: vec3d, d: vec3d) -> wp.float64:
    """Largest a with v + a d in the cone, for v inside."""
    zero = wp.float64(0.0)
    a = determinant(d)
    b = v[0] * d[0] - v[1] * d[1] - v[2] * d[2]
    c = determinant(v)
    limit = LARGEST
    if d[0] < zero:
        limit = -v[0] / d[0]
    discriminant = b * b - a * c
    if discriminant >= zero:
        # roots of a s^2 + 2 b s + c without cancellation
        sign = wp.where(b >= zero, wp.float64(1.0), wp.float64(-1.0))
        t = -(b + sign * wp.sqrt(discriminant))
        if t != zero:
            other = c / t
            if other > zero:
                limit = wp.min(limit, other)
            if a != zero:
                root = t / a
                if root > zero:
                    limit = wp.min(limit, root)
    return limit


@wp.func
def unscaled(v: vec3d, friction: wp.float64) -> vec3d:
    """Return D^-1 v: forces from x, and p or M x from q or W lambda."""
    return vec3d(v[0] / friction, v[1], v[2])


@wp.func
def find_offset(problems: ContactProblems, buffers: InteriorPointBuffers, row: int):
    """q = w - W lambda, the motion without forces."""
    w = problems.worlds[row]
    count = problems.count[w]
    multiply_symmetric(problems.matrix, w, count, problems.force, buffers.offset, row)
    for c in range(count):
        buffers.offset[row, c] = problems.motion[row, c] - buffers.offset[row, c]


@wp.func
def evaluate_iterate(problems: ContactProblems, buffers: InteriorPointBuffers, row: int) -> wp.float64:
    """Take the iterate's forces, motions and what its equation misses; return its residual [N]."""
    w = problems.worlds[row]
    count = problems.count[w]
    mu = problems.friction
    for c in range(count):
        buffers.force[row, c] = unscaled(buffers.x[row, c], mu)
    multiply_symmetric(problems.matrix, w, count, buffers.force, buffers.motion, row)
    for c in range(count):
        motion = buffers.motion[row, c] + buffers.offset[row, c]
        buffers.motion[row, c] = motion
        z = buffers.z[row, c]
        missing = unscaled(motion, mu) - z
        buffers.missing[row, c] = vec3d(missing[0] + tangential_length(z), missing[1], missing[2])
    return largest_residual(buffers.force, buffers.motion, row, count, problems.rho[w], mu)


@wp.func
def assemble_system(problems: ContactProblems, buffers: InteriorPointBuffers, row: int):
    """Fill and factorise M + J H."""
    w = problems.worlds[row]
    count = problems.count[w]
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    weight = mat33d(one / problems.friction, zero, zero, zero, one, zero, zero, zero, one)
    for i in range(count):
        for j in range(count):
            buffers.system[w, i, j] = weight * block_of_symmetric(problems.matrix, w, i, j, count) * weight
        x = buffers.x[row, i]
        z = buffers.z[row, i]
        buffers.system[w, i, i] = buffers.system[w, i, i] + shift_jacobian(z) * scaling(x, z)
    factorise(buffers.system, w, count)


@wp.func
def find_step(problems: ContactProblems, buffers: InteriorPointBuffers, row: int, target: wp.float64) -> wp.float64:
    """Find dx, dz towards x . z = ``target`` [J]; return how far they can be followed, at most to the boundary."""
    w = problems.worlds[row]
    count = problems.count[w]
    for c in range(count):
        z = buffers.z[row, c]
        aim = target * inverse_in_cone(buffers.x[row, c]) - z
        buffers.dz[row, c] = aim
        buffers.dx[row, c] = shift_jacobian(z) * aim - buffers.missing[row, c]
    solve_factorised(buffers.system, w, count, buffers.dx, row)
    limit = LARGEST
    for c in range(count):
        x = buffers.x[row, c]
        z = buffers.z[row, c]
        dx = buffers.dx[row, c]
        dz = buffers.dz[row, c] - scaling(x, z) * dx
        buffers.dz[row, c] = dz
        limit = wp.min(limit, wp.min(step_to_boundary(x, dx), step_to_boundary(z, dz)))
    return limit


@wp.func
def interior_point(
    problems: ContactProblems,
    buffers: InteriorPointBuffers,
    row: int,
    level: wp.float64,
    tolerance: wp.float64,
) -> wp.float64:
    """Leave the forces with the least residual in ``buffers.best``; return that residual [N].

    ``level`` [N] is the normal force of a contact to start from. Neither it nor the friction coefficient may be 0.
    """
    w = problems.worlds[row]
    count = problems.count[w]
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    find_offset(problems, buffers, row)
    gap = zero
    for c in range(count):
        gap = wp.max(gap, wp.length(unscaled(buffers.offset[row, c], problems.friction)))
    for c in range(count):
        buffers.x[row, c] = vec3d(level * problems.friction, zero, zero)
        buffers.z[row, c] = vec3d(FIRST_GAP * gap, zero, zero)
        buffers.best[row, c] = vec3d()
    least = LARGEST
    for _ in range(MAX_ITERATIONS):
        residual = evaluate_iterate(problems, buffers, row)
        if residual < least:
            least = residual
            for c in range(count):
                buffers.best[row, c] = buffers.force[row, c]
        if not wp.isfinite(residual) or least <= tolerance:
            return least
        complementarity = zero
        for c in range(count):
            complementarity += wp.dot(buffers.x[row, c], buffers.z[row, c])
        complementarity /= wp.float64(count)
        assemble_system(problems, buffers, row)
        reach = wp.min(one, find_step(problems, buffers, row, zero))
        centring = wp.clamp((one - reach) * (one - reach), LEAST_CENTRING, MOST_CENTRING)
        length = wp.min(one, BOUNDARY_SHARE * find_step(problems, buffers, row, centring * complementarity))
        for c in range(count):
            buffers.x[row, c] = buffers.x[row, c] + length * buffers.dx[row, c]
            buffers.z[row, c] = buffers.z[row, c] + length * buffers.dz[row, c]
    return least
