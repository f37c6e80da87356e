"""The pickup experiment: settle, squeeze to the target force, measure the features, take the platform away, hold.

Grasp poses are relative to the object: they follow the small rigid motion with which it settles on the platform.
Loading is quasi-static up to the target force; from there on the motion is dynamic. All grasps run as one batch,
each in its own world; a world that is finished is no longer stepped.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from defgrasp_ros.errors import EmptyGraspListError, ResultCode
from defgrasp_ros.evaluation import (
    FINGER_NAMES,
    EvaluationObserver,
    EvaluationOptions,
    GraspEvaluation,
    GraspSample,
    Phase,
    Progress,
)
from defgrasp_ros.experiments.candidate import Candidate, spoken
from defgrasp_ros.experiments.collision import colliding_part
from defgrasp_ros.experiments.features import grasp_features
from defgrasp_ros.experiments.metrics import deformation
from defgrasp_ros.experiments.settling import SettledObject, deformed_state, settle
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator

MAX_BATCH = 64
"""Grasps simulated together; more run in further batches, which bounds the memory."""
FORCE_TOLERANCE = 1e-4
"""Largest deviation of the pads' normal forces from the target at which it counts as reached [-]."""
STILL_CHANGE = 1e-5
"""Largest motion in a step, relative to the object's size, at the target force [-]."""
SQUEEZE_TIME_LIMIT = 3.0
"""Time after the force ramp within which the target force must be reached [s]."""
PLATFORM_YIELD = 0.02
"""Speed with which the platform gives way where one finger presses the object onto it and the other is not there yet
[m/s]."""
PRESSING_SHARE = 0.3
"""Share of the target force at which that finger counts as pressing [-]."""
PLATFORM_ACCELERATION = 0.1
"""With which the platform starts to sink [m/s^2]; gentle, so that the weight is handed over, not dropped."""
LOSS_TIME = 0.02
"""How long a finger must be without contact to count as having lost it [s]."""
REST_DRIFT = 1e-4
"""A held object is at rest when at its present speed it would move less than this in the remaining hold time,
relative to its size [-]."""
REST_TIME = 0.1
"""How long it must be so slow; a swing that turns round is slow for a moment only [s]."""
REST_STEPS = 400
"""Largest number of quasi-static steps in which a held object comes to rest."""
REST_CHANGE = 1e-6
"""Motion in such a step, relative to the object's size, at which it rests [-]."""
LONG_STEP = 4
"""Time steps in one of a hanging object that moves slowly."""
SLOW_MOTION = 1e-2
"""Motion in a long step, relative to the object's size, that counts as slow [-]."""
LOWERING_TIME_LIMIT = 10.0
"""Time within which the platform must have lost the object [s]."""
UP = np.array([0.0, 0.0, 1.0])


def evaluate_grasps(
    object_model: ObjectModel,
    grasps: Sequence[Grasp],
    gripper: Gripper,
    options: EvaluationOptions,
    device: str = "cpu",
    observer: EvaluationObserver | None = None,
) -> list[GraspEvaluation]:
    """Run the pickup experiment for every grasp.

    Args:
        object_model: Object at rest in its frame, z up; it is put on a platform at its lowest point.
        grasps: Candidate poses in the object frame.
        gripper: Pads, stroke and limits.
        options: Constants of the protocol.
        device: Warp device, ``"cpu"`` or ``"cuda:0"``.
        observer: Is told about progress, samples and results while the simulation runs.

    Returns:
        One evaluation per grasp, in their order. What went wrong with a grasp is in its code and message.

    Raises:
        EmptyGraspListError: If there is no grasp.
        NotFoundError: If there is no such device.
        InvalidMeshError: If the mesh has no usable stiffness.
        SolverDivergedError: If the object alone finds no rest on the platform.
    """
    if not grasps:
        raise EmptyGraspListError("grasps is empty: give at least one grasp")
    observer = observer or EvaluationObserver()
    batches = [range(first, min(first + MAX_BATCH, len(grasps))) for first in range(0, len(grasps), MAX_BATCH)]
    simulator = Simulator(object_model, gripper, len(batches[0]) + 1, device)
    observer.on_progress(Progress(Phase.SETTLE, 0.0, 0.0, len(grasps), len(grasps)))
    settled = settle(simulator, len(batches[0]), options.time_step)
    evaluations: list[GraspEvaluation] = []
    start = settled.duration
    for batch in batches:
        chosen = {index: grasps[index] for index in batch}
        pickup = _Pickup(simulator, settled, chosen, options, observer, len(grasps), start)
        evaluations += pickup.run()
        start = pickup.time
    return evaluations


class _Pickup:
    """One batch of grasps: world i belongs to candidate i; the last world keeps the settled object."""

    def __init__(
        self,
        simulator: Simulator,
        settled: SettledObject,
        grasps: dict[int, Grasp],
        options: EvaluationOptions,
        observer: EvaluationObserver,
        total: int,
        start_time: float,
    ):
        self.simulator = simulator
        self.settled = settled
        self.model = simulator.model
        self.gripper = simulator.gripper
        self.options = options
        self.observer = observer
        self.total = total
        self.started = time.monotonic()
        self.time = start_time
        self.stopped = False
        self.next_sample = start_time
        default_force = self.model.default_target_force(options.force_safety_factor)
        self.candidates = []
        for index, grasp in grasps.items():
            target = default_force if grasp.target_force is None else grasp.target_force
            evaluation = GraspEvaluation(index, grasp.id or str(index), target_force=target)
            self.candidates.append(Candidate(settled.follow(grasp), target, evaluation, settled.platform_height))
        self.running = np.arange(len(self.candidates))

    def run(self) -> list[GraspEvaluation]:
        """Go through the phases and return the evaluations."""
        self._close()
        self._squeeze()
        held = self._lower_and_hold()
        self._come_to_rest(held)
        for candidate in self.candidates:
            if not candidate.finished:
                self._finish(candidate, ResultCode.CANCELED, "canceled before this grasp was finished")
        self._progress(Phase.DONE, 1.0)
        return [candidate.evaluation for candidate in self.candidates]

    # --- phases -------------------------------------------------------------------------------------------------

    def _close(self) -> None:
        """Put the open gripper at each pose and move the pads to where the first of them touches."""
        self._progress(Phase.CLOSE, 0.05)
        self.simulator.copy_world(self.simulator.world_count - 1, self.running)
        self.simulator.place_platform(self.running, self.settled.platform_height)
        for candidate in self.candidates:
            self._check_reach(candidate)
        self._drop_finished()
        if not len(self.running):
            return
        chosen = [self.candidates[w] for w in self.running]
        poses = [candidate.grasp for candidate in chosen]
        opening = np.full(len(chosen), self.gripper.max_opening)
        forces = self._targets(self.running)
        self.simulator.place_gripper(self.running, poses, opening, forces)
        gaps = self.simulator.pad_gaps(self.running)
        for candidate, gap in zip(chosen, gaps, strict=True):
            candidate.opening_at_contact = self.gripper.max_opening - gap.mean() if np.isfinite(gap).all() else np.nan
            if not (gap < opening[0]).any():
                self._finish(
                    candidate, ResultCode.NO_CONTACT, "the object is not between the pads: they close on nothing"
                )
        reached = np.clip(opening - gaps.min(axis=1), 0.0, None)
        self.simulator.place_gripper(self.running, poses, reached, forces)
        self._drop_finished()

    def _check_reach(self, candidate: Candidate) -> None:
        """End a grasp that the gripper cannot do: too much force, or no room for the open fingers."""
        gripper, positions = self.gripper, self.settled.state.positions
        if self.options.return_fields:
            candidate.evaluation.fields["pre_contact"] = self.settled.state
        if candidate.target_force > gripper.max_force:
            asked, limit = candidate.target_force, gripper.max_force
            text = f"the target force {asked:.4g} N is above the gripper's limit of {limit:g} N"
            self._finish(candidate, ResultCode.FORCE_NOT_REACHED, text)
            return
        part = colliding_part(self.model.mesh, positions, candidate.grasp, gripper, gripper.max_opening)
        if part:
            width = 2e3 * gripper.max_opening
            text = f"the {spoken(part)} of the open gripper ({width:.1f} mm) is inside the object at this pose"
            self._finish(candidate, ResultCode.GRIPPER_COLLISION, text)

    def _squeeze(self) -> None:
        """Raise the closing force to the target, wait until it is reached, measure the features."""
        h, ramp = self.options.time_step, self.options.squeeze_time
        size = self.model.mesh.size
        elapsed, positions = 0.0, self.simulator.positions(self.running)
        waiting = self.running
        while len(waiting) and not self._canceled():
            elapsed += h
            self.time += h
            share = min(1.0, elapsed / ramp)
            self._progress(Phase.SQUEEZE, 0.1 + 0.4 * share)
            target = self._targets(waiting)
            self._step(waiting, h, share * target, quasi_static=True)
            self._sample(waiting, share * target)
            last, positions = positions, self.simulator.positions(waiting)
            still = np.linalg.norm(positions - last, axis=2).max(axis=1) < STILL_CHANGE * size
            late = elapsed > ramp + SQUEEZE_TIME_LIMIT
            normal, openings = self.simulator.normal_forces(waiting), self.simulator.openings(waiting)
            goes_on = np.ones(len(waiting), dtype=bool)
            for row, w in enumerate(waiting):
                candidate, pads, platform = self.candidates[w], normal[row, :2], normal[row, 2]
                touching = candidate.touching(pads).all()
                candidate.was_gripped |= touching
                if candidate.finished:
                    goes_on[row] = False
                elif elapsed >= ramp and touching and abs(pads.sum() - target[row]) < FORCE_TOLERANCE * target[row]:
                    if still[row] or late:
                        if not still[row]:
                            candidate.remark = "; features were measured in motion"
                        self._measure_features(int(w))
                        goes_on[row] = False
                elif late or openings[row] <= 0.0:
                    self._finish(candidate, *candidate.squeeze_failure(pads, platform, openings[row]))
                    goes_on[row] = False
                elif elapsed >= ramp and not touching and pads.sum() > PRESSING_SHARE * target[row]:
                    if platform > self.model.weight:
                        candidate.platform_height -= PLATFORM_YIELD * h
            waiting, positions = waiting[goes_on], positions[goes_on]
        self._drop_finished()

    def _lower_and_hold(self) -> np.ndarray:
        """Take the platform away and wait until each object is lost or has been held long enough; return those."""
        h, size = self.options.time_step, self.model.mesh.size
        speed, tick = 0.0, 0
        calm = np.zeros(len(self.candidates), dtype=bool)
        held: list[int] = []
        while len(self.running) and not self._canceled():
            speed = min(speed + PLATFORM_ACCELERATION * h, self.options.platform_speed)
            # Calm worlds take one long step when the others take the first of LONG_STEP short ones.
            groups = [(self.running[~calm[self.running]], h)]
            if tick % LONG_STEP == 0:
                groups.append((self.running[calm[self.running]], LONG_STEP * h))
            for worlds, step_length in groups:
                if len(worlds):
                    held += self._hold_step(worlds, step_length, speed, (tick + 1) * h)
            tick += 1
            self.time += h
            times = [self.candidates[w].holding_time for w in self.running]
            phase = Phase.HOLD if max(times) > 0.0 else Phase.LOWER_PLATFORM
            self._progress(phase, 0.5 + 0.45 * min(1.0, min(times) / max(self.options.pickup_hold_time, h)))
            self._sample(self.running, self._targets(self.running))
            self.running = np.setdiff1d(self.running, held)
            self._drop_finished()
            if tick % LONG_STEP == 0 and len(self.running):
                motion = LONG_STEP * h * self._fastest(self.running)
                lifted = np.array([self.candidates[w].holding_time > 0.0 for w in self.running])
                calm[self.running] = lifted & (motion < SLOW_MOTION * size)
        return np.array(held, dtype=int)

    def _hold_step(self, worlds: np.ndarray, h: float, speed: float, elapsed: float) -> list[int]:
        """Advance some hanging worlds with the platform sinking; return those that have been held long enough."""
        for w in worlds:
            self.candidates[w].platform_height -= speed * h
        self._step(worlds, h, self._targets(worlds), quasi_static=False)
        normal, fastest = self.simulator.normal_forces(worlds), self._fastest(worlds)
        return [
            w
            for row, w in enumerate(worlds)
            if not self.candidates[w].finished and self._follow_hold(int(w), h, normal[row], fastest[row], elapsed)
        ]

    def _fastest(self, worlds: np.ndarray) -> np.ndarray:
        """Largest nodal speed [m/s], shape ``(n,)``."""
        return np.linalg.norm(self.simulator.velocities(worlds), axis=2).max(axis=1)

    def _come_to_rest(self, held: np.ndarray) -> None:
        """Stop the swing of objects that have been held long enough, and measure them in equilibrium."""
        h = LONG_STEP * self.options.time_step
        positions = self.simulator.positions(held)
        for step in range(REST_STEPS):
            if not len(held) or self._canceled():
                break
            self.time += h
            self._step(held, h, self._targets(held), quasi_static=True)
            last, positions = positions, self.simulator.positions(held)
            resting = np.linalg.norm(positions - last, axis=2).max(axis=1) < REST_CHANGE * self.model.mesh.size
            normal = self.simulator.normal_forces(held)
            for row, w in enumerate(held):
                candidate = self.candidates[w]
                if candidate.finished:
                    continue
                if not candidate.touching(normal[row, :2]).all():
                    text = "the object slipped out when its swing was stopped"
                    self._finish(candidate, ResultCode.DROPPED, text)
                elif resting[row]:
                    self._measure_pickup(int(w), "picked up and held" + candidate.remark)
                elif step == REST_STEPS - 1:
                    self._measure_pickup(int(w), "picked up and held; metrics were measured in motion")
            goes_on = np.array([not self.candidates[w].finished for w in held])
            held, positions = held[goes_on], positions[goes_on]

    def _follow_hold(self, w: int, h: float, normal: np.ndarray, fastest: float, elapsed: float) -> bool:
        """Decide after a step whether one grasp has lost or goes on; return whether it has held long enough."""
        candidate = self.candidates[w]
        remaining = self.options.pickup_hold_time - candidate.holding_time
        touching = candidate.touching(normal[:2]).all()
        on_platform = candidate.touching(normal[2])
        candidate.time_without_contact = 0.0 if touching else candidate.time_without_contact + h
        candidate.holding_time = 0.0 if on_platform else candidate.holding_time + h
        candidate.phase = Phase.LOWER_PLATFORM if on_platform else Phase.HOLD
        still = touching and not on_platform and fastest * remaining < REST_DRIFT * self.model.mesh.size
        candidate.time_at_rest = candidate.time_at_rest + h if still else 0.0
        if candidate.time_without_contact >= LOSS_TIME:
            candidate.evaluation.holding_time = max(0.0, candidate.holding_time - LOSS_TIME)
            side = FINGER_NAMES[int(np.argmin(normal[:2]))] if normal[:2].max() > 0.0 else "both fingers"
            held = candidate.evaluation.holding_time
            when = f"{held:.2f} s after lift-off" if held > 0.0 else "while the platform went down"
            text = f"the object slipped out: {spoken(side)} lost contact {when}"
            self._finish(candidate, ResultCode.DROPPED, text)
        elif on_platform and elapsed > LOWERING_TIME_LIMIT:
            self._finish(candidate, ResultCode.DROPPED, "the object went down with the platform")
        elif touching and not on_platform and (remaining <= h or candidate.time_at_rest >= REST_TIME):
            candidate.evaluation.holding_time = self.options.pickup_hold_time
            return True
        return False

    # --- measurements -------------------------------------------------------------------------------------------

    def _measure_features(self, w: int) -> None:
        candidate, here = self.candidates[w], np.array([w])
        forces = self.simulator.contact_forces(here)[0]
        fingers = forces.fingers()
        state = deformed_state(self.simulator, w)
        candidate.evaluation.contacts = fingers
        candidate.evaluation.applied_force = float(self.simulator.normal_forces(here)[0, :2].sum())
        candidate.evaluation.features = grasp_features(
            candidate.grasp,
            self.gripper,
            fingers,
            centre_of_mass(self.model, state.positions),
            state.opening,
            candidate.opening_at_contact,
            UP,
        )
        if self.options.return_fields:
            candidate.evaluation.fields["at_target_force"] = state
        pads = forces.body < len(FINGER_NAMES)
        candidate.gripped_nodes = np.unique(forces.nodes[pads][forces.weights[pads] > 0.0])
        candidate.gripped_positions = state.positions[candidate.gripped_nodes]

    def _measure_pickup(self, w: int, message: str) -> None:
        candidate, here = self.candidates[w], np.array([w])
        metrics = candidate.evaluation.metrics
        state = deformed_state(self.simulator, w)
        _, energy = self.simulator.stresses(here)
        metrics.pickup_success = True
        metrics.max_von_mises_stress = float(state.von_mises_stress.max())
        metrics.max_deformation = float(
            deformation(self.settled.state.positions, state.positions, self.model.mesh.node_volumes).max()
        )
        metrics.strain_energy = float(energy[0].sum())
        axis = candidate.grasp.rotation[:, 1]
        shift = (state.positions[candidate.gripped_nodes] - candidate.gripped_positions).mean(axis=0)
        candidate.evaluation.slip_distance = float(np.linalg.norm(shift - axis * (axis @ shift)))
        candidate.evaluation.contacts = self.simulator.contact_forces(here)[0].fingers()
        if self.options.return_fields:
            candidate.evaluation.fields["post_pickup"] = state
        self._finish(candidate, ResultCode.OK, message)

    # --- bookkeeping --------------------------------------------------------------------------------------------

    def _step(self, worlds: np.ndarray, h: float, closing_force: np.ndarray, *, quasi_static: bool) -> None:
        """Advance some worlds; one that finds no solution is finished with the reason."""
        heights = np.array([self.candidates[w].platform_height for w in worlds])
        report = self.simulator.step(worlds, h, closing_force, heights, quasi_static=quasi_static)
        for row, w in enumerate(worlds):
            self.candidates[w].count_step(report, row, h)
            if not report.converged[row]:
                residual = f"residual {report.residual[row]:.2g} of the force scale"
                text = f"no solution of the time step at {self.time:.3f} s: {residual}"
                self._finish(self.candidates[w], ResultCode.SOLVER_DIVERGED, text)

    def _targets(self, worlds: np.ndarray) -> np.ndarray:
        """Target forces [N], shape ``(n,)``."""
        return np.array([self.candidates[w].target_force for w in worlds])

    def _finish(self, candidate: Candidate, code: ResultCode, message: str) -> None:
        candidate.end(code, message)
        candidate.evaluation.simulated_time = self.settled.duration + candidate.time
        candidate.evaluation.wall_time = time.monotonic() - self.started
        self.observer.on_evaluation(candidate.evaluation)

    def _drop_finished(self) -> None:
        self.running = np.array([w for w in self.running if not self.candidates[w].finished], dtype=int)

    def _canceled(self) -> bool:
        self.stopped = self.stopped or self.observer.should_stop()
        return self.stopped

    def _progress(self, phase: Phase, fraction: float) -> None:
        done = self.candidates[0].evaluation.grasp_index
        overall = (done + fraction * len(self.candidates)) / self.total
        self.observer.on_progress(Progress(phase, overall, self.time, len(self.running), self.total))

    def _sample(self, worlds: np.ndarray, closing_force: np.ndarray) -> None:
        """Show the observer the state of the worlds that go on, once per sample interval."""
        if self.time < self.next_sample:
            return
        self.next_sample = self.time + self.observer.sample_interval
        openings = self.simulator.openings(worlds)
        velocities = self.simulator.opening_velocities(worlds)
        for row, (w, forces) in enumerate(zip(worlds, self.simulator.contact_forces(worlds), strict=True)):
            candidate, evaluation = self.candidates[w], self.candidates[w].evaluation
            if candidate.finished:
                continue
            self.observer.on_sample(
                GraspSample(
                    evaluation.grasp_index,
                    evaluation.grasp_id,
                    candidate.phase,
                    self.time,
                    float(openings[row]),
                    float(velocities[row]),
                    float(closing_force[row]),
                    forces.fingers(),
                    forces.normal_force(len(FINGER_NAMES)),
                )
            )


def centre_of_mass(model: ObjectModel, positions: np.ndarray) -> np.ndarray:
    """Return the centre of mass of the deformed object [m], shape ``(3,)``; mass stays with its node."""
    return model.mesh.node_volumes @ positions / model.mesh.volume
