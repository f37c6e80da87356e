"""The reorientation experiment: the hand turns the object about 16 axes, and gravity deforms it anew in every state.

The force is raised to what keeps the object from turning between the fingers, the platform goes away, the fingers are
frozen. Then each axis has its own world, in which gravity turns about it in the frame of the hand, to 45, 90, 135 and
180 degrees.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import Experiment, Phase, ReorientationResult
from defgrasp_ros.experiments.batch import GraspBatch, chunks, no_solution
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.directions import DIRECTION_COUNT, sphere_directions
from defgrasp_ros.experiments.force_ramp import ramp_closing_force
from defgrasp_ros.experiments.interruption import Failure
from defgrasp_ros.experiments.metrics import centre_of_mass, deformation
from defgrasp_ros.experiments.rest import LONG_STEP, RestWatch
from defgrasp_ros.experiments.settling import deformed_state
from defgrasp_ros.experiments.slip_force import rotational_slip_force
from defgrasp_ros.object_model import STANDARD_GRAVITY
from defgrasp_ros.simulation.shard import WorldSnapshot

TURNS = np.array([1, 2, 3, 4]) * np.pi / 4.0
"""Angles about an axis that are recorded [rad]."""
SETTLE_STEPS = 400
"""Largest number of such steps in which an object comes to rest."""
GRAVITY = np.array([0.0, 0.0, -STANDARD_GRAVITY])


class Reorientation:
    """The experiment for one batch."""

    def __init__(self, batch: GraspBatch):
        self.batch = batch
        self.simulator = batch.simulator
        self.settles = batch.options.reorientation_settles
        self.h = LONG_STEP * batch.options.time_step if self.settles else batch.options.time_step
        self.size = batch.model.mesh.size
        self.directions = sphere_directions()
        self.forces: dict[Candidate, float] = {}
        self.results: dict[Candidate, ReorientationResult] = {}
        self.axes: np.ndarray | None = None
        """Number of the axis about which each world turns; None while the objects are lifted."""
        self.lifted: dict[Candidate, WorldSnapshot] = {}
        self.lifted_positions: dict[Candidate, np.ndarray] = {}

    def run(self) -> None:
        """Lift every object that can be picked up with the raised force, and turn it about every axis."""
        chosen = [candidate for candidate in self.batch.candidates if candidate.picked_up]
        for some in chunks(chosen, self.simulator.world_count):
            self._lift(some)
        jobs = [(candidate, axis) for candidate in self.lifted for axis in range(DIRECTION_COUNT)]
        parts = chunks(jobs, self.simulator.world_count)
        for number, part in enumerate(parts):
            self._turn(part, number / len(parts), 1.0 / len(parts))
        for candidate, result in self.results.items():
            candidate.evaluation.reorientation = result
            candidate.evaluation.metrics.deformation_controllability = result.controllability

    # --- from the platform into the air -------------------------------------------------------------------------

    def _lift(self, candidates: list[Candidate]) -> None:
        """Raise the force, take the platform away, let the object hang still, freeze the fingers."""
        worlds, simulator = np.arange(len(candidates)), self.simulator
        simulator.load(worlds, [candidate.squeezed for candidate in candidates])
        start = np.array([candidate.target_force for candidate in candidates])
        end = np.array([self._force(candidate, w) for w, candidate in enumerate(candidates)])
        for candidate, force in zip(candidates, end, strict=True):
            self.forces[candidate], self.results[candidate] = force, self._no_result(force)
        outcome = ramp_closing_force(self.batch, worlds, candidates, start, end, self.batch.options.squeeze_time)
        simulator.remove_platform(worlds)
        gravity = np.tile(GRAVITY, (len(worlds), 1))
        reached = np.array([i for i, failure in enumerate(outcome) if failure is None], dtype=int)
        for i, failure in self._settle([candidates[i] for i in reached], worlds[reached], gravity[reached]).items():
            outcome[reached[i]] = failure
        simulator.freeze_fingers(worlds)
        positions = simulator.positions(worlds)
        for w, candidate, failure in zip(worlds, candidates, outcome, strict=True):
            if failure:
                self.results[candidate].reasons = [failure.message] * DIRECTION_COUNT
            else:
                self.lifted[candidate], self.lifted_positions[candidate] = simulator.save(w), positions[w]

    def _force(self, candidate: Candidate, world: int) -> float:
        """Return the force that keeps the object from turning, within the limits of options and gripper [N]."""
        model, options = self.batch.model, self.batch.options
        positions = self.simulator.positions(np.array([world]))[0]
        contacts = np.concatenate([finger.positions for finger in candidate.squeezed_contacts])
        wanted = rotational_slip_force(
            contacts,
            centre_of_mass(positions, model.mesh.node_volumes),
            candidate.grasp.rotation[:, 1],
            model.weight,
            model.material.friction_coefficient,
            options.force_safety_factor,
        )
        limit = min(options.slip_force_limit * candidate.target_force, self.batch.gripper.max_force)
        return float(np.clip(wanted, candidate.target_force, limit))

    # --- the turns ----------------------------------------------------------------------------------------------

    def _turn(self, jobs: list[tuple[Candidate, int]], done: float, share: float) -> None:
        """Turn gravity about each job's axis, stopping at every angle of ``TURNS``."""
        worlds, simulator = np.arange(len(jobs)), self.simulator
        simulator.load(worlds, [self.lifted[candidate] for candidate, _ in jobs])
        self.axes = np.array([axis for _, axis in jobs])
        axes = self.directions[self.axes]
        if not self.settles:
            self._spin([candidate for candidate, _ in jobs], worlds, axes)
        active, angle = np.arange(len(jobs)), 0.0
        for number, turn in enumerate(TURNS):
            steps = int(np.ceil((turn - angle) / (self.batch.options.reorientation_speed * self.h)))
            for at in np.linspace(angle, turn, steps + 1)[1:]:
                active = self._advance(jobs, active, turned_gravity(axes[active], at), number)
                self.batch.progress(
                    Experiment.REORIENTATION, Phase.REORIENT, done + share * at / TURNS[-1], len(active)
                )
            angle = turn
            if self.settles:
                some = [jobs[i][0] for i in active]
                failures = self._settle(some, active, turned_gravity(axes[active], angle))
                active = self._drop(jobs, active, failures, number)
            self._record(jobs, active, number)

    def _spin(self, candidates: list[Candidate], worlds: np.ndarray, axes: np.ndarray) -> None:
        """Let objects feel that the hand turns about an axis through their centre of mass, at once at full speed."""
        volumes = self.batch.model.mesh.node_volumes
        centres = np.array([centre_of_mass(self.lifted_positions[candidate], volumes) for candidate in candidates])
        speed = self.batch.options.reorientation_speed
        self.simulator.set_spin(worlds, centres, speed * axes, np.zeros_like(axes))

    def _advance(self, jobs: list[tuple[Candidate, int]], active: np.ndarray, gravity: np.ndarray, turn: int):
        """Take one step with gravity turned a little further; return who goes on."""
        if interruption := self.batch.interrupted():
            return self._drop(jobs, active, dict.fromkeys(range(len(active)), interruption), turn)
        if not len(active):
            return active
        failures = self._step([jobs[i][0] for i in active], active, gravity, quasi_static=self.settles)
        return self._drop(jobs, active, failures, turn)

    def _drop(self, jobs, active: np.ndarray, failures: dict[int, Failure], turn: int) -> np.ndarray:
        """Note why some of the active jobs end; return the others."""
        for place, failure in failures.items():
            candidate, axis = jobs[active[place]]
            degrees = np.degrees(TURNS[turn])
            self.results[candidate].reasons[axis] = f"on the way to {degrees:.0f} degrees: {failure.message}"
        return np.delete(active, list(failures))

    def _record(self, jobs: list[tuple[Candidate, int]], active: np.ndarray, turn: int) -> None:
        """Measure the present states."""
        if not len(active):
            return
        reference, volumes = self.batch.settled.state.positions, self.batch.model.mesh.node_volumes
        _, energies = self.simulator.stresses(active)
        for place, i in enumerate(active):
            candidate, axis = jobs[i]
            result, state = self.results[candidate], deformed_state(self.simulator, i)
            lifted = self.lifted_positions[candidate]
            result.max_deformation[axis, turn] = deformation(reference, state.positions, volumes).max()
            result.max_deformation_from_lifted[axis, turn] = deformation(lifted, state.positions, volumes).max()
            result.max_von_mises_stress[axis, turn] = state.von_mises_stress.max()
            result.strain_energy[axis, turn] = energies[place].sum()
            if self.batch.keeps_fields():
                result.states[axis, turn] = state.in_single_precision()

    # --- stepping -----------------------------------------------------------------------------------------------

    def _settle(self, candidates: list[Candidate], worlds: np.ndarray, gravity: np.ndarray) -> dict[int, Failure]:
        """Let objects come to rest; return which did not stay in the hand or found no rest, and why."""
        failures: dict[int, Failure] = {}
        active = np.arange(len(worlds))
        watch = RestWatch(self.simulator.positions(worlds), self.size)
        for _ in range(SETTLE_STEPS):
            if not len(active):
                break
            if interruption := self.batch.interrupted():
                return failures | {int(i): interruption for i in active}
            some = self._step([candidates[i] for i in active], worlds[active], gravity[active], quasi_static=True)
            moves = ~watch.resting(active, self.simulator.positions(worlds[active]))
            failures |= {int(active[place]): failure for place, failure in some.items()}
            moves[list(some)] = False
            active = active[moves]
        text = f"no rest within {SETTLE_STEPS} steps"
        return failures | {int(i): Failure(ResultCode.TIMEOUT, text) for i in active}

    def _step(
        self, candidates: list[Candidate], worlds: np.ndarray, gravity: np.ndarray, *, quasi_static: bool
    ) -> dict[int, Failure]:
        """Advance some worlds; return which failed, and why."""
        simulator, h = self.simulator, self.h
        simulator.set_gravity(worlds, gravity)
        forces = np.array([self.forces[candidate] for candidate in candidates])
        report = simulator.step(worlds, h, forces, np.zeros(len(worlds)), quasi_static=quasi_static)
        self.batch.time += h
        normal = simulator.normal_forces(worlds)[:, :2]
        directions = None if self.axes is None else self.axes[worlds]
        self.batch.sample(worlds, normal.sum(axis=1), candidates, directions)
        failures = {}
        for row, candidate in enumerate(candidates):
            candidate.count_step(report, row, h)
            if not report.usable[row]:
                failures[row] = Failure(ResultCode.SOLVER_DIVERGED, no_solution(report, row, self.batch.time))
            elif not candidate.touching(normal[row]).all():
                failures[row] = Failure(ResultCode.DROPPED, "the object slipped out of the hand")
        return failures

    def _no_result(self, force: float) -> ReorientationResult:
        """Return a result without any state."""
        nothing = [np.full((DIRECTION_COUNT, len(TURNS)), np.nan) for _ in range(4)]
        return ReorientationResult(self.directions, force, *nothing, [""] * DIRECTION_COUNT)


def turned_gravity(axes: np.ndarray, angle: float) -> np.ndarray:
    """Return gravity in the frame of a hand that was turned by ``angle`` [rad] about axes, shape ``(n, 3)`` both."""
    if not len(axes):
        return np.empty((0, 3))
    return Rotation.from_rotvec(angle * axes).inv().apply(GRAVITY)
