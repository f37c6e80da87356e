"""Shows an observer the present state of running grasps, as often as it wants, and only what it wants."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from defgrasp_ros.evaluation import NAN, EvaluationObserver, Experiment, GraspSample, NodalFields, Phase
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.metrics import deformation
from defgrasp_ros.experiments.settling import SettledObject, deformed_state
from defgrasp_ros.periodic import Periodic
from defgrasp_ros.simulation.kernels_faces import PLATFORM
from defgrasp_ros.simulation.simulator import Simulator

PHASES = {
    Experiment.REORIENTATION: Phase.REORIENT,
    Experiment.LINEAR_ACCELERATION: Phase.ACCELERATE,
    Experiment.ANGULAR_ACCELERATION: Phase.ACCELERATE,
    Experiment.SQUEEZE: Phase.SQUEEZE_FREE,
}
"""Of the experiments that consist of one phase."""


class StateSampler:
    """Reads the state of grasps from the simulator.

    Args:
        simulator: Has the worlds.
        settled: The object before contact.
        observer: Is shown the samples.
    """

    def __init__(self, simulator: Simulator, settled: SettledObject, observer: EvaluationObserver):
        self._simulator = simulator
        self._settled = settled
        self._observer = observer
        self._due = Periodic(observer.sample_interval)

    def sample(
        self,
        time: float,
        experiment: Experiment,
        worlds: np.ndarray,
        candidates: Sequence[Candidate],
        closing_force: np.ndarray,
        directions: np.ndarray | None,
        known: list[GraspSample] | None = None,
    ) -> None:
        """Show the observer the worlds of the direction that it follows, if the interval is over and it wants to see.

        Args:
            time: Simulated [s].
            experiment: What is being done.
            worlds: Indices, shape ``(n,)``.
            candidates: The grasp in each world.
            closing_force: Of the drive [N], shape ``(n,)``.
            directions: Which direction each world is, shape ``(n,)``; None: the experiment has none.
            known: The present state of all these worlds, where it was read already; else it is read if it is wanted.
        """
        followed = np.arange(len(worlds))
        direction = None
        if directions is not None:
            direction = self._observer.sample_direction
            followed = np.flatnonzero(directions == direction)
        if not len(followed) or not self._due.is_due(time) or not self._observer.wants_samples():
            return
        self._due.done(time)
        if known is None:
            chosen = [candidates[row] for row in followed]
            known = self.read(time, experiment, worlds[followed], chosen, closing_force[followed], direction)
        self._observer.on_samples(known)

    def read(
        self,
        time: float,
        experiment: Experiment,
        worlds: np.ndarray,
        candidates: Sequence[Candidate],
        closing_force: np.ndarray,
        direction: int | None = None,
    ) -> list[GraspSample]:
        """Return the present state of some worlds; arguments as those of ``sample``, with one direction for all."""
        openings = self._simulator.openings(worlds)
        velocities = self._simulator.opening_velocities(worlds)
        contact_forces = self._simulator.contact_forces(worlds)
        samples = []
        for row, (candidate, forces) in enumerate(zip(candidates, contact_forces, strict=True)):
            platform_force = forces.normal_force(PLATFORM)
            on_platform = experiment is Experiment.PICKUP or platform_force > 0.0
            samples.append(
                GraspSample(
                    grasp_index=candidate.evaluation.grasp_index,
                    grasp_id=candidate.evaluation.grasp_id,
                    grasp=candidate.grasp,
                    experiment=experiment,
                    direction=direction,
                    phase=PHASES.get(experiment, candidate.phase),
                    time=time,
                    opening=float(openings[row]),
                    opening_velocity=float(velocities[row]),
                    closing_force=float(closing_force[row]),
                    contacts=forces.fingers(),
                    palm=forces.palm(),
                    platform_force=platform_force,
                    platform_height=candidate.platform_height if on_platform else NAN,
                    read_fields=partial(self._read_fields, int(worlds[row])),
                )
            )
        return samples

    def _read_fields(self, world: int) -> NodalFields:
        mesh, state = self._simulator.model.mesh, deformed_state(self._simulator, world)
        return NodalFields(
            state.positions,
            deformation(self._settled.state.positions, state.positions, mesh.node_volumes),
            mesh.nodal_mean(state.von_mises_stress),
        )
