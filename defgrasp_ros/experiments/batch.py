"""A batch of grasps on their way through the experiments: who takes part, stepping, and what observers are told."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import (
    EvaluationObserver,
    EvaluationOptions,
    Experiment,
    GraspEvaluation,
    GraspSample,
    Phase,
    Progress,
)
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.discretisation_error import StressRecovery
from defgrasp_ros.experiments.interruption import Failure, Interruption
from defgrasp_ros.experiments.metrics import von_mises_stress
from defgrasp_ros.experiments.settling import SettledObject
from defgrasp_ros.experiments.state_sampler import StateSampler
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.periodic import Periodic
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.simulation.stepper import StepReport

FORCE_TOLERANCE = 1e-4
"""Largest deviation of the pads' normal forces from the target at which it counts as reached [-]."""
WORK_SHARE = {
    Experiment.PICKUP: 1.0,
    Experiment.REORIENTATION: 2.0,
    Experiment.LINEAR_ACCELERATION: 1.0,
    Experiment.ANGULAR_ACCELERATION: 6.0,
    Experiment.SQUEEZE: 1.0,
}
"""Rough work of the experiments relative to each other, in the order in which they are done [-]."""


@dataclass(frozen=True, eq=False)
class Run:
    """What all batches of an evaluation share."""

    simulator: Simulator
    """With at least one world per grasp of a batch."""
    settled: SettledObject
    """The object on the platform."""
    options: EvaluationOptions
    observer: EvaluationObserver
    interruption: Interruption
    stress_recovery: StressRecovery
    grasp_count: int


class GraspBatch:
    """Grasps that are simulated together; candidate i is in world i during the pickup.

    Args:
        run: Object, options and observer.
        grasps: By index in the whole evaluation.
        start_time: Simulated time so far [s].
    """

    def __init__(self, run: Run, grasps: dict[int, Grasp], start_time: float):
        self.run = run
        self.simulator = run.simulator
        self.settled = run.settled
        self.options = run.options
        self.observer = run.observer
        self.model = self.simulator.model
        self.gripper = self.simulator.gripper
        self.time = start_time
        self.experiment = Experiment.PICKUP
        """What is being done."""
        self._started = time.monotonic()
        self._sampler = StateSampler(self.simulator, self.settled, self.observer)
        self._record_due = Periodic(EvaluationObserver.sample_interval)
        default_force = self.model.default_target_force(self.options.force_safety_factor)
        self.candidates = []
        for index, grasp in grasps.items():
            target = default_force if grasp.target_force is None else grasp.target_force
            evaluation = GraspEvaluation(index, grasp.id or str(index), target_force=target)
            height = self.settled.platform_height
            self.candidates.append(Candidate(self.settled.follow(grasp), target, evaluation, height))

    def asks_for(self, *experiments: Experiment) -> bool:
        """Whether one of these experiments is to be done."""
        return not self.options.experiments.isdisjoint(experiments)

    def of(self, worlds: np.ndarray) -> list[Candidate]:
        """Return the candidates in these worlds of the pickup."""
        return [self.candidates[w] for w in worlds]

    def targets(self, worlds: np.ndarray) -> np.ndarray:
        """Target forces [N], shape ``(n,)``."""
        return np.array([candidate.target_force for candidate in self.of(worlds)])

    def step(self, worlds: np.ndarray, h: float, closing_force: np.ndarray, *, quasi_static: bool) -> None:
        """Advance some worlds of the pickup; one that finds no solution is finished with the reason."""
        heights = np.array([candidate.platform_height for candidate in self.of(worlds)])
        report = self.simulator.step(worlds, h, closing_force, heights, quasi_static=quasi_static)
        for row, candidate in enumerate(self.of(worlds)):
            candidate.time += h
            candidate.count_step(report, row, h)
            if not report.usable[row]:
                self.finish(candidate, ResultCode.SOLVER_DIVERGED, no_solution(report, row, self.time))

    def finish(self, candidate: Candidate, code: ResultCode, message: str) -> None:
        """End a candidate's pickup; it is reported at once where nothing follows."""
        candidate.end(code, message)
        candidate.evaluation.pickup = candidate.course.course()
        others = self.options.experiments - {Experiment.PICKUP}
        squeezed = Experiment.SQUEEZE in others and candidate.at_contact is not None
        if not others or (code != ResultCode.OK and not squeezed):
            self.report(candidate)

    def report(self, candidate: Candidate) -> None:
        """Tell the observer that all is known about a candidate."""
        candidate.evaluation.end_time = self.time
        candidate.evaluation.wall_time = time.monotonic() - self._started
        candidate.reported = True
        self.observer.on_evaluation(candidate.evaluation)
        if not self.options.return_fields:
            candidate.evaluation = candidate.evaluation.without_fields()

    def keeps_fields(self) -> bool:
        """Whether somebody wants the fields over the mesh."""
        return self.options.return_fields or self.observer.wants_fields()

    def interrupted(self) -> Failure | None:
        """Return why the run has to end now; None: it may go on."""
        return self.run.interruption.reason()

    def progress(self, experiment: Experiment, phase: Phase, fraction: float, active: int) -> None:
        """Say how far the batch is, ``fraction`` in [0, 1] of one of its experiments."""
        done = self.candidates[0].evaluation.grasp_index
        asked = [e for e in WORK_SHARE if e in self.options.experiments]
        before = sum(WORK_SHARE[e] for e in asked[: asked.index(experiment)])
        within = (before + fraction * WORK_SHARE[experiment]) / sum(WORK_SHARE[e] for e in asked)
        overall = (done + within * len(self.candidates)) / self.run.grasp_count
        self.observer.on_progress(Progress(phase, overall, self.time, active, self.run.grasp_count))

    def sample(
        self,
        worlds: np.ndarray,
        closing_force: np.ndarray,
        candidates: Sequence[Candidate] | None = None,
        directions: np.ndarray | None = None,
    ) -> None:
        """Record the state of the worlds that go on, if this is the pickup, and show it to the observer.

        Args:
            worlds: Indices, shape ``(n,)``.
            closing_force: With which the drive closes the pair of fingers [N], shape ``(n,)``.
            candidates: The grasp in each world; None: those of the pickup.
            directions: Of an experiment with several: which one each world is, shape ``(n,)``.
        """
        known = None
        if candidates is None:
            going = np.flatnonzero([not candidate.finished for candidate in self.of(worlds)])
            worlds, closing_force, candidates = worlds[going], closing_force[going], self.of(worlds[going])
            known = self._record(worlds, closing_force)
        self._sampler.sample(self.time, self.experiment, worlds, candidates, closing_force, directions, known)

    def _record(self, worlds: np.ndarray, closing_force: np.ndarray) -> list[GraspSample] | None:
        """Add the present state to the pickups' courses, once per interval, whatever the observer wants; return it."""
        if not len(worlds) or not self._record_due.is_due(self.time):
            return None
        self._record_due.done(self.time)
        candidates, positions = self.of(worlds), self.simulator.positions(worlds)
        stress, _ = self.simulator.point_stresses(worlds)
        largest_stress = von_mises_stress(stress).max(axis=(1, 2))
        samples = self._sampler.read(self.time, self.experiment, worlds, candidates, closing_force)
        for row, (candidate, sample) in enumerate(zip(candidates, samples, strict=True)):
            slip = candidate.slip(positions[row], candidate.gripped_positions)
            candidate.course.add(sample, candidate.time, slip, largest_stress[row])
        return samples


def no_solution(report: StepReport, row: int, now: float) -> str:
    """Return the text for a world whose step found no solution, or one without meaning."""
    if report.converged[row]:
        return (
            f"elements turned inside out at {now:.3f} s: the load crushes or tears the object, beyond what a linear "
            "material describes"
        )
    return f"no solution of the time step at {now:.3f} s: residual {report.residual[row]:.2g} of the force scale"


def chunks(items: Sequence, size: int) -> list[Sequence]:
    """Cut a sequence into pieces of at most ``size`` entries."""
    return [items[first : first + size] for first in range(0, len(items), size)]
