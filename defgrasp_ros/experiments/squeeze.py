"""The squeeze without gravity: the closing force grows in even steps, and each is recorded at rest."""

from __future__ import annotations

import numpy as np

from defgrasp_ros.evaluation import Experiment, Phase, SqueezeResult
from defgrasp_ros.experiments.batch import GraspBatch, chunks
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.force_ramp import load_free, ramp_closing_force
from defgrasp_ros.experiments.metrics import deformation
from defgrasp_ros.experiments.settling import deformed_state

NEAR_RIGID = 1e8
"""Young's modulus above which the larger force is used [Pa] (DefGraspSim)."""
INCREMENTS = 4
"""Steps in which the force grows from one sample to the next; to the first one it takes ``squeeze_time``."""


class FreeSqueeze:
    """The experiment for one batch: every grasp that touches the object, picked up or not."""

    def __init__(self, batch: GraspBatch):
        self.batch = batch
        options = batch.options
        rigid = batch.model.material.youngs_modulus > NEAR_RIGID
        largest = options.squeeze_force_near_rigid if rigid else options.squeeze_force
        count = options.squeeze_sample_count
        self.forces = min(largest, batch.gripper.max_force) * np.arange(1, count + 1) / count

    def run(self) -> None:
        """Squeeze, and put the results into the evaluations."""
        chosen = [candidate for candidate in self.batch.candidates if candidate.at_contact is not None]
        for some in chunks(chosen, self.batch.simulator.world_count):
            self._squeeze(some)

    def _squeeze(self, candidates: list[Candidate]) -> None:
        worlds = load_free(self.batch, candidates)
        for candidate in candidates:
            nothing = [np.full(len(self.forces), np.nan) for _ in range(4)]
            candidate.evaluation.squeeze = SqueezeResult(self.forces.copy(), *nothing)
        active, before = np.arange(len(candidates)), 0.0
        # Slowly at first: pads that close at once would hold on to the shape that the weight gave the object.
        duration = self.batch.options.squeeze_time
        for sample, force in enumerate(self.forces):
            some = [candidates[i] for i in active]
            start, end = np.full(len(active), before), np.full(len(active), force)
            outcome = ramp_closing_force(self.batch, worlds[active], some, start, end, duration)
            for i, failure in zip(active, outcome, strict=True):
                if failure:
                    candidates[i].evaluation.squeeze.reason = f"at {force:.3g} N: {failure.message}"
                else:
                    self._record(candidates[i], worlds[i], sample)
            active = active[[failure is None for failure in outcome]]
            before, duration = force, INCREMENTS * self.batch.options.time_step
            self.batch.progress(Experiment.SQUEEZE, Phase.SQUEEZE_FREE, (sample + 1) / len(self.forces), len(active))
            if not len(active):
                break

    def _record(self, candidate: Candidate, world: int, sample: int) -> None:
        simulator, mesh = self.batch.simulator, self.batch.model.mesh
        result, state = candidate.evaluation.squeeze, deformed_state(simulator, world)
        here = np.array([world])
        _, energy = simulator.stresses(here)
        result.opening[sample] = state.opening
        reference = self.batch.settled.state.positions
        result.max_deformation[sample] = deformation(reference, state.positions, mesh.node_volumes).max()
        result.max_von_mises_stress[sample] = state.von_mises_stress.max()
        result.strain_energy[sample] = energy[0].sum()
        result.contacts.append(simulator.contact_forces(here)[0].fingers())
        if self.batch.keeps_fields():
            result.states.append(state.in_single_precision())
