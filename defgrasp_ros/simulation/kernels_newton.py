"""A semismooth Newton method for contact problems, on the function of Alart and Curnier.

A line search on the norm of Phi lets it climb for a few iterations. From a good first guess one to four linear systems
are enough; from a bad one it may get stuck.

Points that depend on each other leave the forces undetermined, and the method may then wander. A proximal shift s
helps: with W + s and the offset q - s lambda_0 the solution stays near the forces lambda_0 it began with. Repeated from
each solution, this comes to one of the unshifted problem.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_alart_curnier import phi
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems, largest_residual
from defgrasp_ros.simulation.kernels_newton_system import NewtonSystems, find_change, find_direction
from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

MAX_ITERATIONS = wp.constant(15)
"""Linear systems of one solution; those that are found need few."""
INNER_TOLERANCE = wp.constant(wp.float64(0.3))
"""Residual of a shifted problem relative to that asked of the unshifted one [-]."""
MEMORY = wp.constant(5)
"""Iterations over which the line search compares: a step may climb out of a local minimum of the norm."""
SUFFICIENT_DECREASE = wp.constant(wp.float64(0.1))
STEP_SHRINKAGE = wp.constant(wp.float64(0.3))
SHORTEST_STEP = wp.constant(wp.float64(1e-3))

_norms = wp.types.vector(length=5, dtype=wp.float64)


@wp.struct
class NewtonBuffers:
    """Work space, one row per problem."""

    systems: NewtonSystems
    force: wp.array2d[vec3d]  # (row, contact): the iterate [N]
    motion: wp.array2d[vec3d]  # (row, contact): w of the iterate, shifted [m]
    centre: wp.array2d[vec3d]  # (row, contact): lambda_0 [N]


@wp.func
def norm_of_phi(
    problems: ContactProblems, buffers: NewtonBuffers, row: int, scale: wp.float64, length: wp.float64
) -> wp.float64:
    """Norm of Phi [N] a step of ``length`` along the direction."""
    total = wp.float64(0.0)
    for c in range(problems.count[problems.worlds[row]]):
        force = buffers.force[row, c] + length * buffers.systems.direction[row, c]
        motion = buffers.motion[row, c] + length * buffers.systems.change[row, c]
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
    for c in range(count):
        # What is left there may not be finite, and the first norm takes 0 times it.
        buffers.systems.direction[row, c] = vec3d()
        buffers.systems.change[row, c] = vec3d()
    norms = _norms()
    norms[0] = norm_of_phi(problems, buffers, row, scale, zero)
    for iteration in range(int(MAX_ITERATIONS)):  # int(): not unrolled, which would compile for minutes
        residual = largest_residual(buffers.force, buffers.motion, row, count, problems.rho[w], problems.friction)
        if residual <= tolerance or not wp.isfinite(residual):
            return
        find_direction(problems, buffers.systems, buffers.force, buffers.motion, row, scale, shift)
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
            buffers.force[row, c] = buffers.force[row, c] + length * buffers.systems.direction[row, c]
            buffers.motion[row, c] = buffers.motion[row, c] + length * buffers.systems.change[row, c]


@wp.func
def find_motion(problems: ContactProblems, buffers: NewtonBuffers, row: int):
    """Set the motion to that of the forces."""
    count = problems.count[problems.worlds[row]]
    zero = wp.float64(0.0)
    distance = zero
    for c in range(count):
        moved = buffers.force[row, c] - problems.force[row, c]
        buffers.systems.direction[row, c] = moved
        buffers.motion[row, c] = problems.motion[row, c]
        distance += wp.dot(moved, moved)
    if distance == zero:
        return
    find_change(problems, buffers.systems, row, zero)
    for c in range(count):
        buffers.motion[row, c] = buffers.motion[row, c] + buffers.systems.change[row, c]


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
    find_motion(problems, buffers, row)
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
