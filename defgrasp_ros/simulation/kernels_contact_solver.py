"""Solves the contact problem of each world: by Newton's method where it works, otherwise by what it takes.

The attempts, each from the forces of the iteration before:

1. Newton's method as it is. Its scale lies between that of the elastic and that of the rigid body.
2. In rounds with a proximal shift: for points that depend on each other.
3. The same with the elastic scale.
4. From the best iterate of an interior point method: for near-rigid bodies that slide.
5. Ten times as it is, from random normal forces without friction, the same in every run: for what is left.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_block_matrix import block_of_symmetric
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems
from defgrasp_ros.simulation.kernels_interior_point import InteriorPointBuffers, interior_point
from defgrasp_ros.simulation.kernels_newton import NewtonBuffers, newton
from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

SCALE = wp.constant(wp.float64(0.2))
"""Scale of Newton's method relative to the geometric mean of the elastic and the rigid one [-]."""
SMALL_SCALE = wp.constant(wp.float64(0.1))
"""Scale after the interior point method, relative to the one above [-]."""
PROXIMITY = wp.constant(wp.float64(1e-3))
"""Proximal shift relative to the elastic scale [-]."""
ROUNDS = wp.constant(6)
PLAIN, PROXIMAL, ELASTIC, INTERIOR, RANDOM = (wp.constant(number) for number in range(5))
"""Attempts by number; those from ``RANDOM`` on begin with random forces."""
ATTEMPTS = wp.constant(RANDOM + 10)


@wp.kernel
def solve_contacts(
    rows: Rows,
    problems: ContactProblems,
    tolerance: wp.array[wp.float64],  # (world,): largest accepted residual [N]
    newton_buffers: NewtonBuffers,
    interior_buffers: InteriorPointBuffers,
    # Out:
    force_out: wp.array2d[vec3d],  # (row, contact): the best that was found [N]
    attempts_out: wp.array[int],  # (row,): methods that were tried
):
    """Find the forces that obey the laws of contact. Whether they do tells the caller's own residual."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    count = problems.count[w]
    attempts_out[i] = 0
    newton_buffers.systems.solved[i] = 0
    newton_buffers.systems.factorised[i] = 0
    if count == 0:
        return
    trace = wp.float64(0.0)
    level = wp.float64(0.0)
    gap = wp.float64(0.0)
    for c in range(count):
        trace += wp.trace(block_of_symmetric(problems.matrix, w, c, c, count))
        level += wp.abs(problems.force[i, c][0])
        gap = wp.max(gap, wp.length(problems.motion[i, c]))
        force_out[i, c] = problems.force[i, c]
    level /= wp.float64(count)
    if level == wp.float64(0.0):
        # Points that carried nothing so far: what moves a point alone by the largest motion without forces.
        level = gap * wp.float64(3 * count) / trace
    mean = SCALE * wp.sqrt(problems.rho[w] * trace)
    least = wp.float64(wp.inf)
    for attempt in range(int(ATTEMPTS)):  # int(): not unrolled
        attempts_out[i] = attempt + 1
        scale = mean
        shift = PROXIMITY * problems.rho[w]
        rounds = ROUNDS
        if attempt == PLAIN or attempt >= RANDOM:
            shift = wp.float64(0.0)
            rounds = 1
        if attempt == ELASTIC:
            scale = problems.rho[w]
        for c in range(count):
            newton_buffers.force[i, c] = problems.force[i, c]
        if attempt == INTERIOR:
            if problems.friction == wp.float64(0.0):
                continue
            interior_point(problems, interior_buffers, i, level, tolerance[w])
            scale = SMALL_SCALE * mean
            for c in range(count):
                newton_buffers.force[i, c] = interior_buffers.best[i, c]
        if attempt >= RANDOM:
            # The same in every run, whatever other problems there are.
            generator = wp.rand_init(attempt)
            for c in range(count):
                share = wp.float64(wp.randf(generator))
                newton_buffers.force[i, c] = vec3d(wp.float64(2.0) * level * share, wp.float64(0.0), wp.float64(0.0))
        residual = newton(problems, newton_buffers, i, scale, shift, rounds, tolerance[w])
        if residual < least:
            least = residual
            for c in range(count):
                force_out[i, c] = newton_buffers.force[i, c]
        if least <= tolerance[w]:
            return
