"""A semismooth Newton method for contact problems, on the function of Alart and Curnier (1991).

    Phi(lambda) = lambda - (max(0, n), P_disk(t)),   (n, t) = lambda - w / r,   radius of the disk: mu max(0, n).

The scale r [m/N] sets the path, not the solution. A line search on the norm of Phi lets it climb for a few iterations.
From a good first guess one to four linear systems are enough; from a bad one it may get stuck.

Points that depend on each other leave the forces undetermined, and the method may then wander. A proximal shift s
helps: with W + s and the offset q - s lambda_0 the solution stays near the forces lambda_0 it began with. Repeated from
each solution, this comes to one of the unshifted problem.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_block_matrix import factorise, multiply, solve_factorised
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems, largest_residual, tangential_length
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})

MAX_ITERATIONS = wp.constant(15)
"""Linear systems of one solution; those that are found need few."""
INNER_TOLERANCE = wp.constant(wp.float64(0.3))
"""Residual of a shifted problem relative to that asked of the unshifted one [-]."""
MEMORY = wp.constant(5)
"""Iterations over which the line search compares: a step may climb out of a local minimum of the norm."""
REGULARISATION = wp.constant(wp.float64(1e-6))
"""Shift of the diagonal [-]: neighbouring points can depend on each other, this picks one of the equal solutions."""
SUFFICIENT_DECREASE = wp.constant(wp.float64(0.1))
STEP_SHRINKAGE = wp.constant(wp.float64(0.3))
SHORTEST_STEP = wp.constant(wp.float64(1e-3))

_norms = wp.types.vector(length=5, dtype=wp.float64)


@wp.struct
class NewtonBuffers:
    """Work space, one row per problem."""

    force: wp.array2d[vec3d]  # (row, contact): the iterate [N]
    motion: wp.array2d[vec3d]  # (row, contact): w of the iterate, shifted [m]
    centre: wp.array2d[vec3d]  # (row, contact): lambda_0 [N]
    direction: wp.array2d[vec3d]  # (row, contact) [N]
    change: wp.array2d[vec3d]  # (row, contact): (W + s) direction [m]
    pressed: wp.array2d[int]  # (row, contact): contacts that are closed
    right_side: wp.array2d[vec3d]  # (row, pressed contact)
    system: wp.array3d[mat33d]  # (row, contact, contact)
    systems: wp.array[int]  # (row,): linear systems so far


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
    """Return an element of the generalised Jacobian of ``alart_curnier`` at a pressed contact."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
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


@wp.func
def find_change(problems: ContactProblems, buffers: NewtonBuffers, row: int, shift: wp.float64):
    """change = (W + s) direction."""
    w = problems.worlds[row]
    count = problems.count[w]
    multiply(problems.matrix, w, count, buffers.direction, buffers.change, row)
    for c in range(count):
        buffers.change[row, c] = buffers.change[row, c] + shift * buffers.direction[row, c]


@wp.func
def find_direction(problems: ContactProblems, buffers: NewtonBuffers, row: int, scale: wp.float64, shift: wp.float64):
    """Solve the linearised system; contacts that are open just give up their force."""
    w = problems.worlds[row]
    count = problems.count[w]
    mu = problems.friction
    closed = int(0)
    for c in range(count):
        trial = buffers.force[row, c] - buffers.motion[row, c] / scale
        if trial[0] > wp.float64(0.0):
            buffers.pressed[row, closed] = c
            closed += 1
            buffers.direction[row, c] = vec3d()
        else:
            buffers.direction[row, c] = -buffers.force[row, c]
    if closed == 0:
        return
    # (1 - S (1 - (W + s) / r)) d = -Phi - S (W + s) d_open / r over the pressed contacts
    find_change(problems, buffers, row, shift)
    for a in range(closed):
        c = buffers.pressed[row, a]
        force = buffers.force[row, c]
        motion = buffers.motion[row, c]
        slope = alart_curnier_slope(force - motion / scale, mu)
        value = phi(force, motion, scale, mu)
        buffers.right_side[row, a] = -value - slope * (buffers.change[row, c] / scale)
        scaled = slope / scale
        for b in range(closed):
            buffers.system[row, a, b] = scaled * problems.matrix[w, c, buffers.pressed[row, b]]
        diagonal = wp.identity(n=3, dtype=wp.float64) * (wp.float64(1.0) + REGULARISATION) - slope + shift * scaled
        buffers.system[row, a, a] = buffers.system[row, a, a] + diagonal
    factorise(buffers.system, row, closed)
    solve_factorised(buffers.system, row, closed, buffers.right_side)
    buffers.systems[row] = buffers.systems[row] + 1
    for a in range(closed):
        buffers.direction[row, buffers.pressed[row, a]] = buffers.right_side[row, a]


@wp.func
def norm_of_phi(
    problems: ContactProblems, buffers: NewtonBuffers, row: int, scale: wp.float64, length: wp.float64
) -> wp.float64:
    """Norm of Phi [N] a step of ``length`` along the direction."""
    total = wp.float64(0.0)
    for c in range(problems.count[problems.worlds[row]]):
        force = buffers.force[row, c] + length * buffers.direction[row, c]
        motion = buffers.motion[row, c] + length * buffers.change[row, c]
        value = phi(force, motion, scale, problems.friction)
        total += wp.dot(value, value)
    return wp.sqrt(total)


@wp.func
def iterate(
    problems: ContactProblems,
    buffers: NewtonBuffers,
    row: int,
    scale: wp.float64,
    shift: wp.float64,
    tolerance: wp.float64,
):
    """Improve the forces and their shifted motions until their residual is below ``tolerance`` [N], or get stuck."""
    w = problems.worlds[row]
    count = problems.count[w]
    zero = wp.float64(0.0)
    norms = _norms()
    norms[0] = norm_of_phi(problems, buffers, row, scale, zero)
    for iteration in range(MAX_ITERATIONS):
        residual = largest_residual(buffers.force, buffers.motion, row, count, problems.rho[w], problems.friction)
        if residual <= tolerance or not wp.isfinite(residual):
            return
        find_direction(problems, buffers, row, scale, shift)
        find_change(problems, buffers, row, shift)
        reference = zero
        for k in range(MEMORY):
            reference = wp.max(reference, norms[k])
        length = wp.float64(1.0)
        norm = norm_of_phi(problems, buffers, row, scale, length)
        while norm >= (wp.float64(1.0) - SUFFICIENT_DECREASE * length) * reference and length >= SHORTEST_STEP:
            length *= STEP_SHRINKAGE
            norm = norm_of_phi(problems, buffers, row, scale, length)
        norms[(iteration + 1) % MEMORY] = norm
        for c in range(count):
            buffers.force[row, c] = buffers.force[row, c] + length * buffers.direction[row, c]
            buffers.motion[row, c] = buffers.motion[row, c] + length * buffers.change[row, c]


@wp.func
def newton(
    problems: ContactProblems,
    buffers: NewtonBuffers,
    row: int,
    scale: wp.float64,
    shift: wp.float64,
    rounds: int,
    tolerance: wp.float64,
) -> wp.float64:
    """Solve the problem from the forces in the buffers, in up to ``rounds`` rounds, each shifted around the last.

    Returns the residual of the natural map [N], which is not finite where the iteration broke down.
    """
    w = problems.worlds[row]
    count = problems.count[w]
    multiply(problems.matrix, w, count, buffers.force, buffers.motion, row)
    for c in range(count):
        buffers.motion[row, c] = buffers.motion[row, c] + problems.offset[row, c]
    residual = largest_residual(buffers.force, buffers.motion, row, count, problems.rho[w], problems.friction)
    aim = tolerance
    if shift > wp.float64(0.0):
        aim = INNER_TOLERANCE * tolerance
    for _ in range(rounds):
        if residual <= tolerance or not wp.isfinite(residual):
            return residual
        for c in range(count):
            buffers.centre[row, c] = buffers.force[row, c]
        iterate(problems, buffers, row, scale, shift, aim)
        for c in range(count):
            moved = buffers.force[row, c] - buffers.centre[row, c]
            buffers.motion[row, c] = buffers.motion[row, c] - shift * moved
        residual = largest_residual(buffers.force, buffers.motion, row, count, problems.rho[w], problems.friction)
    return residual
