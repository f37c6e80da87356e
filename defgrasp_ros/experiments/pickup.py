"""The pickup experiment: settle, squeeze to the target force, measure the features, take the platform away, hold.

Grasp poses are relative to the object: they follow the small rigid motion with which it settles on the platform.
Loading is quasi-static up to the target force; from there on the motion is dynamic. All grasps run as one batch,
each in its own world; a world that is finished is no longer stepped.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import EmptyGraspListError, ResultCode
from defgrasp_ros.evaluation import (
    FINGER_NAMES,
    DeformedState,
    EvaluationObserver,
    EvaluationOptions,
    GraspEvaluation,
    GraspSample,
    Phase,
    Progress,
)
from defgrasp_ros.experiments.collision import colliding_finger
from defgrasp_ros.experiments.features import grasp_features
from defgrasp_ros.experiments.metrics import deformation, rigid_motion, von_mises_stress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.simulation.stepper import StepReport

MAX_BATCH = 64
"""Grasps simulated together; more run in further batches, which bounds the memory."""
SETTLE_STEPS = 80
"""Largest number of steps for the object to settle on the platform."""
SETTLED_CHANGE = 1e-6
"""Change of shape in a step, relative to the object's size, at which it counts as settled [-]."""
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
TOUCHING_SHARE = 1e-6
"""Normal force, relative to the target force, above which a finger touches [-]."""
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
"""Time steps in one while all that still hangs moves slowly."""
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
        InvalidMeshError: If the mesh has no usable stiffness.
    """
    if not grasps:
        raise EmptyGraspListError("grasps is empty: give at least one grasp")
    observer = observer or EvaluationObserver()
    batches = [range(first, min(first + MAX_BATCH, len(grasps))) for first in range(0, len(grasps), MAX_BATCH)]
    simulator = Simulator(object_model, gripper, len(batches[0]) + 1, device)
    evaluations: list[GraspEvaluation] = []
    start = 0.0
    for batch in batches:
        experiment = _Pickup(simulator, [(i, grasps[i]) for i in batch], options, observer, len(grasps), start)
        evaluations += experiment.run()
        start = experiment.time
    return evaluations


@dataclass
class _World:
    """Bookkeeping of one grasp while it is simulated."""

    grasp: Grasp
    """Pose after settling."""
    target_force: float
    evaluation: GraspEvaluation
    platform_height: float
    finished: bool = False
    opening_at_contact: float = np.nan
    holding_time: float = 0.0
    time_without_contact: float = 0.0
    time_at_rest: float = 0.0
    gripped_nodes: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    gripped_positions: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))


class _Pickup:
    """One batch of grasps; world i belongs to grasp i, the last world keeps the settled object."""

    def __init__(
        self,
        simulator: Simulator,
        grasps: list[tuple[int, Grasp]],
        options: EvaluationOptions,
        observer: EvaluationObserver,
        total: int,
        start_time: float,
    ):
        self.simulator = simulator
        self.model = simulator.model
        self.gripper = simulator.gripper
        self.options = options
        self.observer = observer
        self.total = total
        self.started = time.monotonic()
        self.time = start_time
        self.next_sample = start_time
        self.settled_world = simulator.world_count - 1
        self.platform_height = float(self.model.mesh.vertices[:, 2].min())
        default_force = self.model.default_target_force(options.force_safety_factor)
        self.worlds = []
        for index, grasp in grasps:
            target = default_force if grasp.target_force is None else grasp.target_force
            evaluation = GraspEvaluation(index, grasp.id or str(index), target_force=target)
            self.worlds.append(_World(grasp, target, evaluation, self.platform_height))
        self.running = np.arange(len(self.worlds))

    def run(self) -> list[GraspEvaluation]:
        """Go through the phases and return the evaluations."""
        self._settle()
        self._close()
        self._squeeze()
        self._lower_and_hold()
        self._progress(Phase.DONE, 1.0)
        return [world.evaluation for world in self.worlds]

    # --- phases -------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Let the object sag on the platform; its state is that before contact with the gripper."""
        self._progress(Phase.SETTLE, 0.0)
        world = np.array([self.settled_world])
        rest, weights = self.model.mesh.vertices, self.model.mesh.node_volumes
        shape = rest
        if self._is_first_batch():
            self.simulator.place_platform(np.arange(self.simulator.world_count), self.platform_height)
            for _ in range(SETTLE_STEPS):
                height = np.array([self.platform_height])
                report = self._step(world, self.options.time_step, np.zeros(1), height, quasi_static=True)
                if not report.converged.all():
                    break
                last, shape = shape, self.simulator.positions(world)[0]
                if deformation(last, shape, weights).max() < SETTLED_CHANGE * self.model.mesh.size:
                    break
        self.pre_contact = replace(self._deformed_states(world)[0], opening=np.nan)
        self.settling_rotation, self.settling_translation = rigid_motion(rest, self.pre_contact.positions, weights)

    def _is_first_batch(self) -> bool:
        return bool(
            np.array_equal(self.simulator.positions(np.array([self.settled_world]))[0], self.model.mesh.vertices)
        )

    def _close(self) -> None:
        """Put the open gripper at each pose and move the pads to where the first of them touches."""
        self._progress(Phase.CLOSE, 0.05)
        self.simulator.copy_world(self.settled_world, self.running)
        for world in self.worlds:
            orientation = Rotation.from_matrix(self.settling_rotation @ world.grasp.rotation).as_quat()
            position = self.settling_rotation @ world.grasp.position + self.settling_translation
            world.grasp = replace(world.grasp, position=position, orientation=orientation)
            if self.options.return_fields:
                world.evaluation.fields["pre_contact"] = self.pre_contact
            if world.target_force > self.gripper.max_force:
                limit = self.gripper.max_force
                text = f"the target force {world.target_force:.4g} N is above the gripper's limit of {limit:g} N"
                self._finish(world, ResultCode.FORCE_NOT_REACHED, text)
                continue
            finger = colliding_finger(
                self.model.mesh, self.pre_contact.positions, world.grasp, self.gripper, self.gripper.max_opening
            )
            if finger:
                width = 2e3 * self.gripper.max_opening
                text = f"the {_spoken(finger)} of the open gripper ({width:.1f} mm) is inside the object at this pose"
                self._finish(world, ResultCode.GRIPPER_COLLISION, text)
        self._drop_finished()
        if not len(self.running):
            return
        chosen = [self.worlds[w] for w in self.running]
        opening = np.full(len(chosen), self.gripper.max_opening)
        forces = np.array([world.target_force for world in chosen])
        self.simulator.place_gripper(self.running, [world.grasp for world in chosen], opening, forces)
        gaps = self.simulator.pad_gaps(self.running)
        for world, gap in zip(chosen, gaps, strict=True):
            if not (gap < opening[0]).any():
                self._finish(world, ResultCode.NO_CONTACT, "the object is not between the pads: they close on nothing")
        reached = np.clip(opening - gaps.min(axis=1), 0.0, None)
        self.simulator.place_gripper(self.running, [world.grasp for world in chosen], reached, forces)
        self._drop_finished()

    def _squeeze(self) -> None:
        """Raise the closing force to the target, wait until it is reached, measure the features."""
        h, ramp = self.options.time_step, self.options.squeeze_time
        size = self.model.mesh.size
        elapsed, positions = 0.0, self.simulator.positions(self.running)
        waiting = self.running
        while len(waiting) and not self._canceled():
            elapsed += h
            share = min(1.0, elapsed / ramp)
            self._progress(Phase.SQUEEZE, 0.1 + 0.4 * share)
            target = np.array([self.worlds[w].target_force for w in waiting])
            self._step(waiting, h, share * target, self._platform_heights(waiting), quasi_static=True)
            normal = self.simulator.normal_forces(waiting)
            openings = self.simulator.openings(waiting)
            last, positions = positions, self.simulator.positions(waiting)
            motion = np.linalg.norm(positions - last, axis=2).max(axis=1)
            self._sample(Phase.SQUEEZE, waiting, share * target)
            pads = normal[:, :2]
            touching = (pads > TOUCHING_SHARE * target[:, None]).all(axis=1)
            loaded = (np.abs(pads.sum(axis=1) - target) < FORCE_TOLERANCE * target) & (elapsed >= ramp)
            reached = loaded & touching
            pressing = (pads.sum(axis=1) > PRESSING_SHARE * target) & (elapsed >= ramp)
            pressed_down = pressing & ~touching & (normal[:, 2] > self.model.weight)
            for w in waiting[pressed_down]:
                self.worlds[w].platform_height -= PLATFORM_YIELD * h
            ready = reached & (motion < STILL_CHANGE * size)
            late = elapsed > ramp + SQUEEZE_TIME_LIMIT
            for row, w in enumerate(waiting):
                world = self.worlds[w]
                if np.isnan(world.opening_at_contact) and touching[row]:
                    world.opening_at_contact = openings[row]
                if world.finished:
                    continue
                if ready[row] or (late and reached[row]):
                    self._measure_features(int(w))
                elif openings[row] <= 0.0:
                    self._finish_empty(world)
                elif late:
                    self._finish_short(world, pads[row], normal[row, 2])
            done = ready | (late & reached)
            keep = np.array([not done[row] and not self.worlds[w].finished for row, w in enumerate(waiting)])
            waiting, positions = waiting[keep], positions[keep]
        self._drop_finished()

    def _lower_and_hold(self) -> None:
        """Take the platform away and wait until each object has been held long enough, or is lost."""
        hold, size = self.options.pickup_hold_time, self.model.mesh.size
        elapsed, speed = 0.0, 0.0
        held: list[int] = []
        h = self.options.time_step
        while len(self.running) and not self._canceled():
            elapsed += h
            speed = min(speed + PLATFORM_ACCELERATION * h, self.options.platform_speed)
            for w in self.running:
                self.worlds[w].platform_height -= speed * h
            target = np.array([self.worlds[w].target_force for w in self.running])
            self._step(self.running, h, target, self._platform_heights(self.running), quasi_static=False)
            self._drop_finished()
            if not len(self.running):
                break
            normal = self.simulator.normal_forces(self.running)
            fastest = np.linalg.norm(self.simulator.velocities(self.running), axis=2).max(axis=1)
            times = [self.worlds[w].holding_time for w in self.running]
            phase = Phase.HOLD if max(times) > 0.0 else Phase.LOWER_PLATFORM
            self._progress(phase, 0.5 + 0.45 * min(1.0, min(times) / max(hold, h)))
            self._sample(phase, self.running, np.array([self.worlds[w].target_force for w in self.running]))
            succeeded = [
                w
                for row, w in enumerate(self.running)
                if self._follow_hold(int(w), h, normal[row], fastest[row], elapsed)
            ]
            held += succeeded
            self.running = np.setdiff1d(self.running, succeeded)
            long_step = LONG_STEP * self.options.time_step
            calm = (normal[:, 2] == 0.0).all() and fastest.max() * long_step < SLOW_MOTION * size
            h = long_step if calm else self.options.time_step
            self._drop_finished()
        self._come_to_rest(np.array(held, dtype=int))
        for w in self.running:
            self._finish(
                self.worlds[w], ResultCode.CANCELED, "the evaluation was canceled before this grasp was finished"
            )
        self._drop_finished()

    def _come_to_rest(self, held: np.ndarray) -> None:
        """Stop the swing of objects that have been held long enough, and measure them in equilibrium."""
        h = LONG_STEP * self.options.time_step
        positions = self.simulator.positions(held)
        for step in range(REST_STEPS):
            if not len(held) or self._canceled():
                break
            target = np.array([self.worlds[w].target_force for w in held])
            self._step(held, h, target, self._platform_heights(held), quasi_static=True)
            last, positions = positions, self.simulator.positions(held)
            motion = np.linalg.norm(positions - last, axis=2).max(axis=1)
            touching = (self.simulator.normal_forces(held)[:, :2] > TOUCHING_SHARE * target[:, None]).all(axis=1)
            resting = (motion < REST_CHANGE * self.model.mesh.size) | (step == REST_STEPS - 1)
            for row, w in enumerate(held):
                if not self.worlds[w].finished and not touching[row]:
                    self._finish(
                        self.worlds[w], ResultCode.DROPPED, "the object slipped out when its swing was stopped"
                    )
                elif not self.worlds[w].finished and resting[row]:
                    self._measure_pickup(int(w))
            keep = np.array([not self.worlds[w].finished for w in held])
            held, positions = held[keep], positions[keep]
        self.running = np.concatenate([self.running, held])

    def _follow_hold(self, w: int, h: float, normal: np.ndarray, fastest: float, elapsed: float) -> bool:
        """Decide after a step whether one grasp has lost or goes on; return whether it has held long enough."""
        world = self.worlds[w]
        remaining = self.options.pickup_hold_time - world.holding_time
        touching = (normal[:2] > TOUCHING_SHARE * world.target_force).all()
        on_platform = normal[2] > 0.0
        world.time_without_contact = 0.0 if touching else world.time_without_contact + h
        world.holding_time = 0.0 if on_platform else world.holding_time + h
        still = not on_platform and fastest * remaining < REST_DRIFT * self.model.mesh.size
        world.time_at_rest = world.time_at_rest + h if still else 0.0
        if world.time_without_contact >= LOSS_TIME:
            world.evaluation.holding_time = max(0.0, world.holding_time - LOSS_TIME)
            side = FINGER_NAMES[int(np.argmin(normal[:2]))] if normal[:2].max() > 0.0 else "both fingers"
            held = world.evaluation.holding_time
            when = f"{held:.2f} s after lift-off" if held > 0.0 else "while the platform went down"
            text = f"the object slipped out: {_spoken(side)} lost contact {when}"
            self._finish(world, ResultCode.DROPPED, text)
        elif on_platform and elapsed > LOWERING_TIME_LIMIT:
            self._finish(world, ResultCode.DROPPED, "the object went down with the platform")
        elif not on_platform and (remaining <= h or world.time_at_rest >= REST_TIME):
            world.evaluation.holding_time = self.options.pickup_hold_time
            return True
        return False

    # --- measurements -------------------------------------------------------------------------------------------

    def _measure_features(self, w: int) -> None:
        world, here = self.worlds[w], np.array([w])
        forces = self.simulator.contact_forces(here)[0]
        fingers = forces.fingers()
        state = self._deformed_states(here)[0]
        world.evaluation.contacts = fingers
        world.evaluation.applied_force = sum(finger.normal_force for finger in fingers)
        world.evaluation.features = grasp_features(
            world.grasp,
            self.gripper,
            fingers,
            volume_centroid(self.model, state.positions),
            state.opening,
            world.opening_at_contact,
            UP,
        )
        if self.options.return_fields:
            world.evaluation.fields["at_target_force"] = state
        pads = forces.body < len(FINGER_NAMES)
        world.gripped_nodes = np.unique(forces.nodes[pads][forces.weights[pads] > 0.0])
        world.gripped_positions = state.positions[world.gripped_nodes]

    def _measure_pickup(self, w: int) -> None:
        world, here = self.worlds[w], np.array([w])
        metrics = world.evaluation.metrics
        state = self._deformed_states(here)[0]
        _, energy = self.simulator.stresses(here)
        metrics.pickup_success = True
        metrics.max_von_mises_stress = float(state.von_mises_stress.max())
        metrics.max_deformation = float(
            deformation(self.pre_contact.positions, state.positions, self.model.mesh.node_volumes).max()
        )
        metrics.strain_energy = float(energy[0].sum())
        axis = world.grasp.rotation[:, 1]
        shift = (state.positions[world.gripped_nodes] - world.gripped_positions).mean(axis=0)
        world.evaluation.slip_distance = float(np.linalg.norm(shift - axis * (axis @ shift)))
        world.evaluation.contacts = self.simulator.contact_forces(here)[0].fingers()
        if self.options.return_fields:
            world.evaluation.fields["post_pickup"] = state
        self._finish(world, ResultCode.OK, "picked up and held")

    def _deformed_states(self, worlds: np.ndarray) -> list[DeformedState]:
        stress, _ = self.simulator.stresses(worlds)
        openings = self.simulator.openings(worlds)
        return [
            DeformedState(positions.copy(), von_mises_stress(tensors), float(opening))
            for positions, tensors, opening in zip(self.simulator.positions(worlds), stress, openings, strict=True)
        ]

    # --- bookkeeping --------------------------------------------------------------------------------------------

    def _step(
        self, worlds: np.ndarray, h: float, closing_force: np.ndarray, heights: np.ndarray, *, quasi_static: bool
    ) -> StepReport:
        """Advance some worlds; one that finds no solution is finished with the reason."""
        report = self.simulator.step(worlds, h, closing_force, heights, quasi_static=quasi_static)
        self.time += h
        for row, w in enumerate(worlds):
            if w == self.settled_world:
                continue
            world = self.worlds[w]
            solver = world.evaluation.solver
            solver.iterations += int(report.iterations[row])
            solver.step_cuts += int(report.cuts[row])
            solver.contact_fallbacks += int(report.contact_fallbacks[row])
            if report.converged[row]:
                solver.steps += 1
                solver.residual = max(solver.residual, float(report.residual[row]))
            else:
                solver.converged = False
                solver.residual = float(report.residual[row])
                residual = f"residual {report.residual[row]:.2g} of the force scale"
                text = f"no solution of the time step at {self.time:.3f} s: {residual}"
                self._finish(world, ResultCode.SOLVER_DIVERGED, text)
        return report

    def _platform_heights(self, worlds: np.ndarray) -> np.ndarray:
        return np.array([self.worlds[w].platform_height for w in worlds])

    def _finish_empty(self, world: _World) -> None:
        if np.isnan(world.opening_at_contact):
            self._finish(world, ResultCode.NO_CONTACT, "the pads met without both having touched the object")
        else:
            self._finish(world, ResultCode.FORCE_NOT_REACHED, "the object was squeezed out from between the pads")

    def _finish_short(self, world: _World, pads: np.ndarray, platform: float) -> None:
        touched = [
            name for name, force in zip(FINGER_NAMES, pads, strict=True) if force > TOUCHING_SHARE * world.target_force
        ]
        if len(touched) == 2:
            text = f"the pads reached {pads.sum():.4g} N of the {world.target_force:.4g} N asked for"
            self._finish(world, ResultCode.FORCE_NOT_REACHED, text)
        else:
            only = f"only the {_spoken(touched[0])} touches" if touched else "no finger touches"
            text = f"{only}: the object does not move up to the other one (platform force {platform:.3g} N)"
            self._finish(world, ResultCode.NO_CONTACT, text)

    def _finish(self, world: _World, code: ResultCode, message: str) -> None:
        evaluation = world.evaluation
        evaluation.code, evaluation.message = code, message
        evaluation.simulated_time = self.time
        evaluation.wall_time = time.monotonic() - self.started
        world.finished = True
        self.observer.on_evaluation(evaluation)

    def _drop_finished(self) -> None:
        self.running = np.array([w for w in self.running if not self.worlds[w].finished], dtype=int)

    def _canceled(self) -> bool:
        return self.observer.should_stop()

    def _progress(self, phase: Phase, fraction: float) -> None:
        done = self.worlds[0].evaluation.grasp_index
        overall = (done + fraction * len(self.worlds)) / self.total
        self.observer.on_progress(Progress(phase, overall, self.time, len(self.running), self.total))

    def _sample(self, phase: Phase, worlds: np.ndarray, closing_force: np.ndarray) -> None:
        """Show the observer the state of the worlds, once per sample interval."""
        if self.time < self.next_sample:
            return
        self.next_sample = self.time + self.observer.sample_interval
        openings = self.simulator.openings(worlds)
        velocities = self.simulator.opening_velocities(worlds)
        for row, (w, forces) in enumerate(zip(worlds, self.simulator.contact_forces(worlds), strict=True)):
            evaluation = self.worlds[w].evaluation
            self.observer.on_sample(
                GraspSample(
                    evaluation.grasp_index,
                    evaluation.grasp_id,
                    phase,
                    self.time,
                    float(openings[row]),
                    float(velocities[row]),
                    float(closing_force[row]),
                    forces.fingers(),
                    forces.normal_force(len(FINGER_NAMES)),
                )
            )


def volume_centroid(model: ObjectModel, positions: np.ndarray) -> np.ndarray:
    """Return the mass centroid of the deformed object [m], shape ``(3,)``; mass stays with its node."""
    return model.mesh.node_volumes @ positions / model.mesh.volume


def _spoken(finger: str) -> str:
    return finger.replace("_", " ")
