"""The acceleration experiments: the hand accelerates ever faster until a finger loses the object.

Without gravity, the fingers frozen after the squeeze. In the frame of the hand an acceleration is a body force:
-m a of a linear one; of a turn about an axis through the midpoint between the fingertips, Euler's, the centrifugal and
Coriolis' force. All grasps and directions run together, each in its own world, from the same squeezed state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defgrasp_ros.evaluation import (
    FINGER_NAMES,
    AccelerationResult,
    EvaluationOptions,
    Experiment,
    GraspEvaluation,
    Phase,
)
from defgrasp_ros.experiments.batch import GraspBatch, chunks, no_solution
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.directions import DIRECTION_COUNT, sphere_directions
from defgrasp_ros.experiments.force_ramp import load_free, ramp_closing_force
from defgrasp_ros.experiments.interruption import Failure
from defgrasp_ros.simulation.gross_slip import GROSS_SLIP_SHARE
from defgrasp_ros.simulation.shard import WorldSnapshot
from defgrasp_ros.simulation.simulator import Simulator


@dataclass(frozen=True)
class Kind:
    """Linear or angular."""

    experiment: Experiment
    jerk: Callable[[EvaluationOptions], float]
    limit: Callable[[EvaluationOptions], float]
    apply: Callable[[Simulator, np.ndarray, np.ndarray, np.ndarray, float, float], None]
    """Set acceleration and velocity in worlds, with directions and centres."""
    put: Callable[[GraspEvaluation, AccelerationResult], None]
    """Store the result."""


def _accelerate(simulator, worlds, directions, centres, acceleration, velocity) -> None:
    simulator.set_gravity(worlds, -acceleration * directions)


def _spin(simulator, worlds, directions, centres, acceleration, velocity) -> None:
    simulator.set_spin(worlds, centres, velocity * directions, acceleration * directions)


def _put_linear(evaluation: GraspEvaluation, result: AccelerationResult) -> None:
    evaluation.linear_acceleration = result
    evaluation.metrics.linear_instability = result.instability


def _put_angular(evaluation: GraspEvaluation, result: AccelerationResult) -> None:
    evaluation.angular_acceleration = result
    evaluation.metrics.angular_instability = result.instability


LINEAR = Kind(
    Experiment.LINEAR_ACCELERATION,
    lambda options: options.linear_jerk,
    lambda options: options.max_linear_acceleration,
    _accelerate,
    _put_linear,
)
ANGULAR = Kind(
    Experiment.ANGULAR_ACCELERATION,
    lambda options: options.angular_jerk,
    lambda options: options.max_angular_acceleration,
    _spin,
    _put_angular,
)


def frozen_without_gravity(batch: GraspBatch) -> dict[Candidate, WorldSnapshot | Failure]:
    """Squeeze the objects that were picked up once more, without gravity and platform, and freeze the fingers there.

    Returns:
        For each candidate the world from which its directions branch, or why there is none.
    """
    frozen: dict[Candidate, WorldSnapshot | Failure] = {}
    chosen = [candidate for candidate in batch.candidates if candidate.picked_up]
    for some in chunks(chosen, batch.simulator.world_count):
        worlds = load_free(batch, some)
        forces = np.array([candidate.target_force for candidate in some])
        nothing = np.zeros(len(some))
        outcome = ramp_closing_force(batch, worlds, some, nothing, forces, batch.options.squeeze_time)
        for w, candidate, failure in zip(worlds, some, outcome, strict=True):
            batch.simulator.freeze_fingers(np.array([w]))
            frozen[candidate] = failure or batch.simulator.save(w)
    return frozen


class _Run:
    """One grasp in one direction."""

    def __init__(self, candidate: Candidate, number: int):
        self.candidate = candidate
        self.number = number
        self.at_loss = np.nan
        self.at_slip = np.nan
        self.is_lower_bound = False
        self.reason = ""
        self._share_used = 0.0

    def note_friction(self, share_used: float, last: float, acceleration: float) -> None:
        """Find out whether gross slip began while the acceleration rose from ``last``; it is taken to rise evenly."""
        if np.isnan(self.at_slip) and share_used > GROSS_SLIP_SHARE:
            rise = (GROSS_SLIP_SHARE - self._share_used) / (share_used - self._share_used)
            self.at_slip = last + rise * (acceleration - last)
        self._share_used = share_used


class AccelerationTest:
    """The linear or the angular test for one batch."""

    def __init__(self, batch: GraspBatch, kind: Kind, frozen: dict[Candidate, WorldSnapshot | Failure]):
        self.batch = batch
        self.kind = kind
        self.frozen = frozen
        self.simulator = batch.simulator
        self.h = batch.options.acceleration_time_step
        self.jerk, self.limit = kind.jerk(batch.options), kind.limit(batch.options)
        self.directions = sphere_directions()

    def run(self) -> None:
        """Run every direction of every grasp, and put the results into the evaluations."""
        runs = [_Run(candidate, number) for candidate in self.frozen for number in range(DIRECTION_COUNT)]
        ready = []
        for run in runs:
            start = self.frozen[run.candidate]
            if isinstance(start, Failure):
                run.reason = start.message
            else:
                ready.append(run)
        parts = chunks(ready, self.simulator.world_count)
        for number, part in enumerate(parts):
            self._ramp(part, number / len(parts), 1.0 / len(parts))
        for candidate in self.frozen:
            mine = [run for run in runs if run.candidate is candidate]
            result = AccelerationResult(
                self.directions,
                np.array([run.at_loss for run in mine]),
                np.array([run.at_slip for run in mine]),
                np.array([run.is_lower_bound for run in mine]),
                [run.reason for run in mine],
            )
            self.kind.put(candidate.evaluation, result)

    def _mobilised_friction(self, runs: list[_Run], worlds: np.ndarray) -> np.ndarray:
        """Used share of the friction of that finger which holds better [-], shape ``(n,)``; 1 once the object slid."""
        holding = np.flatnonzero([np.isnan(run.at_slip) for run in runs])
        shares = np.ones(len(runs))
        for row, forces in zip(holding, self.simulator.contact_forces(worlds[holding]), strict=True):
            shares[row] = min(forces.mobilised_friction(pad) for pad in range(len(FINGER_NAMES)))
        return shares

    def _ramp(self, runs: list[_Run], done: float, share: float) -> None:
        """Raise the acceleration until each run has lost the object, or the end of the test is reached."""
        count = len(runs)
        worlds = np.arange(count)
        self.simulator.load(worlds, [self.frozen[run.candidate] for run in runs])
        directions = self.directions[[run.number for run in runs]]
        centres = np.array([fingertip_midpoint(run.candidate, self.batch.gripper.tip) for run in runs])
        forces = np.array([run.candidate.target_force for run in runs])
        heights = np.zeros(count)
        thresholds = np.array([run.candidate.touching_force for run in runs])
        normal = self.simulator.normal_forces(worlds)[:, :2]
        before, acceleration, velocity = normal.copy(), 0.0, 0.0
        active = np.arange(count)
        while len(active) and not self.batch.interrupted():
            last = acceleration
            acceleration = min(last + self.jerk * self.h, self.limit)
            velocity += self.h * acceleration
            self.kind.apply(self.simulator, worlds[active], directions[active], centres[active], acceleration, velocity)
            report = self.simulator.step(worlds[active], self.h, forces[active], heights[active], quasi_static=False)
            self.batch.time += self.h
            now = self.simulator.normal_forces(worlds[active])[:, :2]
            self.batch.sample(
                worlds[active],
                now.sum(axis=1),
                [runs[i].candidate for i in active],
                np.array([runs[i].number for i in active]),
            )
            share_used = self._mobilised_friction([runs[i] for i in active], worlds[active])
            goes_on = np.ones(len(active), dtype=bool)
            for row, i in enumerate(active):
                run = runs[i]
                run.candidate.count_step(report, row, self.h)
                lost = now[row] <= thresholds[i]
                if report.crushed[row]:
                    run.at_loss, run.is_lower_bound = last, True
                elif not report.converged[row]:
                    run.reason = no_solution(report, row, self.batch.time)
                elif lost.any():
                    finger = int(np.argmin(now[row]))
                    run.at_loss = _crossing(before[i, finger], normal[i, finger], last, acceleration)
                else:
                    run.note_friction(share_used[row], last, acceleration)
                    if acceleration >= self.limit:
                        run.at_loss, run.is_lower_bound = self.limit, True
                goes_on[row] = not run.reason and np.isnan(run.at_loss)
            before[active], normal[active] = normal[active], now
            active = active[goes_on]
            fraction = done + share * acceleration / self.limit
            self.batch.progress(self.kind.experiment, Phase.ACCELERATE, fraction, len(active))
        for i in active:
            runs[i].reason = self.batch.interrupted().message


def fingertip_midpoint(candidate: Candidate, tip: float) -> np.ndarray:
    """Return the point about which the hand turns [m], object frame, shape ``(3,)``."""
    return candidate.grasp.position + tip * candidate.grasp.rotation[:, 2]


def _crossing(before: float, normal: float, last: float, acceleration: float) -> float:
    """Return the acceleration at which a force that fell from ``before`` to ``normal`` reaches 0, within the step.

    The force was ``before`` one step earlier than at ``last``, ``normal`` at ``last``, and is gone at ``acceleration``.
    """
    fall = before - normal
    share = min(1.0, normal / fall) if fall > 0.0 else 1.0
    return last + share * (acceleration - last)
