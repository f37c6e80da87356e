"""Raising the closing force quasi-statically, until it is reached and the object is still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.experiments.batch import FORCE_TOLERANCE, GraspBatch, no_solution
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.interruption import Failure
from defgrasp_ros.experiments.rest import LONG_STEP, STILL_CHANGE, largest_motion

RAMP_TIME_LIMIT = 3.0
"""Time after the ramp within which the force must be reached [s]."""


def load_free(batch: GraspBatch, candidates: Sequence[Candidate]) -> np.ndarray:
    """Put objects without gravity and platform between pads that just touch; return the worlds."""
    worlds = np.arange(len(candidates))
    simulator = batch.simulator
    simulator.load(worlds, [candidate.at_contact for candidate in candidates])
    simulator.remove_platform(worlds)
    simulator.set_gravity(worlds, np.zeros(3))
    return worlds


def ramp_closing_force(
    batch: GraspBatch,
    worlds: np.ndarray,
    candidates: Sequence[Candidate],
    start: np.ndarray,
    end: np.ndarray,
    duration: float,
) -> list[Failure | None]:
    """Raise the closing force from ``start`` to ``end`` [N], shape ``(n,)``, in ``duration`` [s]; wait for stillness.

    Returns:
        Per world why the force was not reached, or None.
    """
    simulator, size = batch.simulator, batch.model.mesh.size
    outcome: list[Failure | None] = [None] * len(worlds)
    heights = np.array([candidate.platform_height for candidate in candidates])
    waiting, elapsed = np.arange(len(worlds)), 0.0
    positions = simulator.positions(worlds)
    while len(waiting):
        if interruption := batch.interrupted():
            for i in waiting:
                outcome[i] = interruption
            break
        h = batch.options.time_step * (1 if elapsed < duration else LONG_STEP)
        elapsed += h
        batch.time += h
        force = start[waiting] + min(1.0, elapsed / duration) * (end - start)[waiting]
        report = simulator.step(worlds[waiting], h, force, heights[waiting], quasi_static=True)
        batch.sample(worlds[waiting], force, [candidates[i] for i in waiting])
        last, positions[waiting] = positions[waiting], simulator.positions(worlds[waiting])
        still = largest_motion(last, positions[waiting]) < STILL_CHANGE * size
        pads = simulator.normal_forces(worlds[waiting])[:, :2]
        openings = simulator.openings(worlds[waiting])
        late = elapsed > duration + RAMP_TIME_LIMIT
        goes_on = np.ones(len(waiting), dtype=bool)
        for row, i in enumerate(waiting):
            candidate = candidates[i]
            candidate.count_step(report, row, h)
            touching = (pads[row] > candidate.touching_force).all()
            reached = abs(pads[row].sum() - end[i]) < FORCE_TOLERANCE * end[i]
            if not report.usable[row]:
                outcome[i] = Failure(ResultCode.SOLVER_DIVERGED, no_solution(report, row, batch.time))
            elif openings[row] <= 0.0:
                outcome[i] = Failure(ResultCode.FORCE_NOT_REACHED, "the object was squeezed out from between the pads")
            elif elapsed >= duration and touching and reached and still[row]:
                goes_on[row] = False
            elif late:
                text = f"the pads reached {pads[row].sum():.4g} N of {end[i]:.4g} N, or the object did not come to rest"
                outcome[i] = Failure(ResultCode.FORCE_NOT_REACHED, text)
            goes_on[row] &= outcome[i] is None
        waiting = waiting[goes_on]
    return outcome
