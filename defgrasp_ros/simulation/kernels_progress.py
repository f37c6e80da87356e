"""Kernels that judge how the step of each world goes, so that nobody else need look at it in between."""

import warp as wp

from defgrasp_ros.simulation.anderson import DEPTH
from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

TOLERANCE = 1e-6
"""Largest residual of a solved step, relative to the force scale [-]."""
CONTACT_TOLERANCE = wp.constant(wp.float64(2e-7))
"""The same for the contact problem inside an iteration [-]."""
CONTACT_REDUCTION = wp.constant(wp.float64(1e-3))
"""Early iterations need no better contact forces than this fraction of their residual [-]."""
MAX_ITERATIONS = wp.constant(40)
"""Iterations after which a step is given up; all counts begin anew where overlooked contacts were found."""
MAX_STALLED = wp.constant(8)
"""Iterations in a row that do not reduce the residual after which a step is given up."""
RESTART_GROWTH = wp.constant(wp.float64(2.0))
"""Growth of the residual in an iteration at which the acceleration starts anew [-], unless it has just begun: where the
plain iteration diverges, it must be let go on until it knows the modes that grow."""
MAX_SEARCHES = wp.constant(5)
"""How often a solved step may find contacts that it overlooked before it counts as failed."""

RUNNING, SOLVED, CONVERGED, FAILED = (wp.constant(number) for number in range(4))
"""Where a step can be; a solved one has converged when no contact was overlooked."""


@wp.struct
class Progress:
    """How far each world is with its step."""

    state: wp.array[int]  # (world,): RUNNING ... FAILED
    force_scale: wp.array[wp.float64]  # (world,): force to which residuals are compared [N]
    residual: wp.array[wp.float64]  # (world,): relative to the force scale [-]
    last_residual: wp.array[wp.float64]  # (world,): of the iteration before [-]
    best_residual: wp.array[wp.float64]  # (world,) [-]
    contact_tolerance: wp.array[wp.float64]  # (world,): for the contact problem of this iteration [N]
    iterations: wp.array[int]  # (world,)
    spent: wp.array[int]  # (world,): iterations since contacts were last added
    stalled: wp.array[int]  # (world,): iterations in a row without progress
    searches: wp.array[int]  # (world,): how often contacts were overlooked
    accelerated: wp.array[int]  # (world,): iterations since the step began or growth last started the acceleration anew
    hard: wp.array[int]  # (world,): contact problems that needed more than their first method


def new_progress(world_count: int, device: wp.Device) -> Progress:
    """Return the arrays for some worlds."""
    progress = Progress()
    for name, field in Progress.vars.items():
        setattr(progress, name, wp.zeros(world_count, dtype=field.type.dtype, device=device))
    return progress


@wp.kernel
def begin_step(rows: Rows, progress: Progress, history: wp.array[int]):
    """Nothing is known yet; nor is there a history (world,) of the acceleration."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    progress.state[w] = RUNNING
    progress.residual[w] = wp.float64(wp.inf)
    progress.last_residual[w] = wp.float64(wp.inf)
    progress.best_residual[w] = wp.float64(wp.inf)
    progress.iterations[w] = 0
    progress.spent[w] = 0
    progress.stalled[w] = 0
    progress.searches[w] = 0
    progress.accelerated[w] = 0
    progress.hard[w] = 0
    history[w] = 0


@wp.kernel
def judge(
    rows: Rows,
    nodal_residual: wp.array2d[vec3d],  # (world, node) [N]
    contact_residual: wp.array[wp.float64],  # (world,) [N]
    progress: Progress,
):
    """Compare the worse of nodal and contact residual with the tolerance."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    total = wp.float64(0.0)
    for n in range(nodal_residual.shape[1]):
        total += wp.dot(nodal_residual[w, n], nodal_residual[w, n])
    worse = wp.sqrt(total)
    if not worse > contact_residual[w]:  # so that what is no number stays so
        worse = contact_residual[w]
    if not wp.isfinite(total):
        worse = total
    progress.residual[w] = worse / progress.force_scale[w]
    progress.state[w] = RUNNING
    if progress.residual[w] < wp.float64(wp.static(TOLERANCE)):
        progress.state[w] = SOLVED


@wp.kernel
def decide(
    rows: Rows,
    missing: wp.array[int],  # (world,): contacts that a solved world has overlooked
    progress: Progress,
    history: wp.array[int],  # (world,): length of the acceleration's history
):
    """Settle whether a world goes on to another iteration, and how."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    residual = progress.residual[w]
    progress.stalled[w] = progress.stalled[w] + 1
    if residual < progress.best_residual[w]:
        progress.stalled[w] = 0
        progress.best_residual[w] = residual

    if progress.state[w] == SOLVED:
        if missing[w] == 0:
            progress.state[w] = CONVERGED
            return
        progress.searches[w] = progress.searches[w] + 1
        progress.spent[w] = 0
        progress.stalled[w] = 0
        progress.best_residual[w] = wp.float64(wp.inf)
        history[w] = 0
        progress.state[w] = RUNNING
        if progress.searches[w] > MAX_SEARCHES:
            progress.state[w] = FAILED
    elif not wp.isfinite(residual) or progress.stalled[w] > MAX_STALLED or progress.spent[w] >= MAX_ITERATIONS:
        progress.state[w] = FAILED
    if progress.state[w] == FAILED:
        return

    if residual > RESTART_GROWTH * progress.last_residual[w] and progress.accelerated[w] >= DEPTH:
        history[w] = 0
        progress.accelerated[w] = 0
    progress.accelerated[w] = progress.accelerated[w] + 1
    progress.last_residual[w] = residual
    progress.iterations[w] = progress.iterations[w] + 1
    progress.spent[w] = progress.spent[w] + 1
    progress.contact_tolerance[w] = progress.force_scale[w] * wp.max(CONTACT_TOLERANCE, CONTACT_REDUCTION * residual)
