"""The pickup experiment: squeeze to the target force, measure the features, take the platform away, hold.

Loading is quasi-static up to the target force; from there on the motion is dynamic. A world that is finished is no
longer stepped.
"""

from __future__ import annotations

import numpy as np

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import FINGER_NAMES, Experiment, Phase
from defgrasp_ros.experiments.batch import FORCE_TOLERANCE, GraspBatch
from defgrasp_ros.experiments.candidate import Candidate, spoken
from defgrasp_ros.experiments.collision import colliding_part
from defgrasp_ros.experiments.features import grasp_features
from defgrasp_ros.experiments.metrics import centre_of_mass, deformation
from defgrasp_ros.experiments.rest import LONG_STEP, STILL_CHANGE, RestWatch, largest_motion
from defgrasp_ros.experiments.settling import deformed_state
from defgrasp_ros.simulation.kernels_faces import PALM, PLATFORM

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
SLOW_STEP = 4
"""Time steps in one of a hanging object that moves slowly."""
SLOW_MOTION = 1e-2
"""Motion in a long step, relative to the object's size, that counts as slow [-]."""
LOWERING_TIME_LIMIT = 10.0
"""Time within which the platform must have lost the object [s]."""
UP = np.array([0.0, 0.0, 1.0])


class Pickup:
    """The experiment for one batch: world i belongs to candidate i."""

    def __init__(self, batch: GraspBatch):
        self.batch = batch
        self.simulator = batch.simulator
        self.settled = batch.settled
        self.model = batch.model
        self.gripper = batch.gripper
        self.options = batch.options
        self.running = np.arange(len(batch.candidates))

    def run(self) -> None:
        """Go through the phases; the outcome is in the candidates' evaluations."""
        self._close()
        self._squeeze()
        held = self._lower_and_hold()
        self._come_to_rest(held)
        for candidate in self.batch.candidates:
            if not candidate.finished:
                why = self.batch.interrupted()
                self.batch.finish(candidate, why.code, f"ended before this grasp was finished: {why.message}")

    # --- phases -------------------------------------------------------------------------------------------------

    def _close(self) -> None:
        """Put the open gripper at each pose and move the pads to where the first of them touches."""
        self._progress(Phase.CLOSE, 0.05)
        self.simulator.load(self.running, [self.settled.snapshot] * len(self.running))
        for candidate in self.batch.candidates:
            self._check_reach(candidate)
        self._drop_finished()
        if not len(self.running):
            return
        chosen = self.batch.of(self.running)
        poses = [candidate.grasp for candidate in chosen]
        opening = np.full(len(chosen), self.gripper.max_opening)
        forces = self.batch.targets(self.running)
        self.simulator.place_gripper(self.running, poses, opening, forces)
        gaps = self.simulator.pad_gaps(self.running)
        for candidate, gap in zip(chosen, gaps, strict=True):
            candidate.opening_at_contact = self.gripper.max_opening - gap.mean() if np.isfinite(gap).all() else np.nan
            if not (gap < opening[0]).any():
                self.batch.finish(
                    candidate, ResultCode.NO_CONTACT, "the object is not between the pads: they close on nothing"
                )
        reached = np.clip(opening - gaps.min(axis=1), 0.0, None)
        self.simulator.place_gripper(self.running, poses, reached, forces)
        self._drop_finished()
        for w in self.running:
            self.batch.candidates[w].at_contact = self.simulator.save(w)

    def _check_reach(self, candidate: Candidate) -> None:
        """End a grasp that the gripper cannot do: too much force, or no room for the open fingers."""
        gripper, positions = self.gripper, self.settled.state.positions
        if self.batch.keeps_fields():
            candidate.evaluation.fields["pre_contact"] = self.settled.state
        if candidate.target_force > gripper.max_force:
            asked, limit = candidate.target_force, gripper.max_force
            text = f"the target force {asked:.4g} N is above the gripper's limit of {limit:g} N"
            self.batch.finish(candidate, ResultCode.FORCE_NOT_REACHED, text)
            return
        part = colliding_part(self.model.mesh, positions, candidate.grasp, gripper, gripper.max_opening)
        if part:
            width = 2e3 * gripper.max_opening
            text = f"the {spoken(part)} of the open gripper ({width:.1f} mm) is inside the object at this pose"
            self.batch.finish(candidate, ResultCode.GRIPPER_COLLISION, text)

    def _squeeze(self) -> None:
        """Raise the closing force to the target, wait until it is reached, measure the features."""
        h, ramp = self.options.time_step, self.options.squeeze_time
        size = self.model.mesh.size
        elapsed, positions = 0.0, self.simulator.positions(self.running)
        waiting = self.running
        while len(waiting) and not self.batch.interrupted():
            elapsed += h
            self.batch.time += h
            share = min(1.0, elapsed / ramp)
            self._progress(Phase.SQUEEZE, 0.1 + 0.4 * share)
            target = self.batch.targets(waiting)
            self.batch.step(waiting, h, share * target, quasi_static=True)
            self.batch.sample(waiting, share * target)
            last, positions = positions, self.simulator.positions(waiting)
            still = largest_motion(last, positions) < STILL_CHANGE * size
            late = elapsed > ramp + SQUEEZE_TIME_LIMIT
            normal, openings = self.simulator.normal_forces(waiting), self.simulator.openings(waiting)
            goes_on = np.ones(len(waiting), dtype=bool)
            for row, w in enumerate(waiting):
                candidate, pads, platform = self.batch.candidates[w], normal[row, :2], normal[row, 2]
                touching = candidate.touching(pads).all()
                candidate.was_gripped |= touching
                if candidate.finished:
                    goes_on[row] = False
                elif elapsed >= ramp and touching and abs(pads.sum() - target[row]) < FORCE_TOLERANCE * target[row]:
                    if still[row] or late:
                        if not still[row]:
                            candidate.remark = "; features were measured in motion"
                        self._measure_features(int(w))
                        candidate.squeezed = self.simulator.save(w)
                        goes_on[row] = False
                elif late or openings[row] <= 0.0:
                    self.batch.finish(candidate, *candidate.squeeze_failure(pads, platform, openings[row]))
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
        calm = np.zeros(len(self.batch.candidates), dtype=bool)
        held: list[int] = []
        for candidate in self.batch.of(self.running):
            candidate.lowering_began = candidate.time
        while len(self.running) and not self.batch.interrupted():
            speed = min(speed + PLATFORM_ACCELERATION * h, self.options.platform_speed)
            # Calm worlds take one long step when the others take the first of SLOW_STEP short ones.
            groups = [(self.running[~calm[self.running]], h)]
            if tick % SLOW_STEP == 0:
                groups.append((self.running[calm[self.running]], SLOW_STEP * h))
            for worlds, step_length in groups:
                if len(worlds):
                    held += self._hold_step(worlds, step_length, speed, (tick + 1) * h)
            tick += 1
            self.batch.time += h
            times = [self.batch.candidates[w].holding_time for w in self.running]
            phase = Phase.HOLD if max(times) > 0.0 else Phase.LOWER_PLATFORM
            self._progress(phase, 0.5 + 0.45 * min(1.0, min(times) / max(self.options.pickup_hold_time, h)))
            self.batch.sample(self.running, self.batch.targets(self.running))
            self.running = np.setdiff1d(self.running, held)
            self._drop_finished()
            if tick % SLOW_STEP == 0 and len(self.running):
                motion = SLOW_STEP * h * self._fastest(self.running)
                lifted = np.array([self.batch.candidates[w].holding_time > 0.0 for w in self.running])
                calm[self.running] = lifted & (motion < SLOW_MOTION * size)
        return np.array(held, dtype=int)

    def _hold_step(self, worlds: np.ndarray, h: float, speed: float, elapsed: float) -> list[int]:
        """Advance some hanging worlds with the platform sinking; return those that have been held long enough."""
        for w in worlds:
            self.batch.candidates[w].platform_height -= speed * h
        self.batch.step(worlds, h, self.batch.targets(worlds), quasi_static=False)
        normal, fastest = self.simulator.normal_forces(worlds), self._fastest(worlds)
        positions = self.simulator.positions(worlds)
        held = []
        for row, (w, candidate) in enumerate(zip(worlds, self.batch.of(worlds), strict=True)):
            if not candidate.finished:
                self._follow_slip(candidate, normal[row], positions[row])
                if self._follow_hold(candidate, h, normal[row], fastest[row], elapsed):
                    held.append(w)
        return held

    def _fastest(self, worlds: np.ndarray) -> np.ndarray:
        """Largest nodal speed [m/s], shape ``(n,)``."""
        return np.linalg.norm(self.simulator.velocities(worlds), axis=2).max(axis=1)

    def _come_to_rest(self, held: np.ndarray) -> None:
        """Stop the swing of objects that have been held long enough, and measure them in equilibrium."""
        h = LONG_STEP * self.options.time_step
        watch, rows = RestWatch(self.simulator.positions(held), self.model.mesh.size), np.arange(len(held))
        for step in range(REST_STEPS):
            if not len(held) or self.batch.interrupted():
                break
            self.batch.time += h
            self.batch.step(held, h, self.batch.targets(held), quasi_static=True)
            self.batch.sample(held, self.batch.targets(held))
            resting = watch.resting(rows, self.simulator.positions(held))
            normal = self.simulator.normal_forces(held)
            for row, w in enumerate(held):
                candidate = self.batch.candidates[w]
                if candidate.finished:
                    continue
                if not candidate.touching(normal[row, :2]).all():
                    candidate.evaluation.loss_of_contact_time = candidate.time - h - candidate.lowering_began
                    text = "the object slipped out when its swing was stopped"
                    self.batch.finish(candidate, ResultCode.DROPPED, text)
                elif resting[row]:
                    self._measure_pickup(int(w), "picked up and held" + candidate.remark)
                elif step == REST_STEPS - 1:
                    self._measure_pickup(int(w), "picked up and held; metrics were measured in motion")
            goes_on = np.array([not self.batch.candidates[w].finished for w in held])
            held, rows = held[goes_on], rows[goes_on]

    @staticmethod
    def _follow_slip(candidate: Candidate, normal: np.ndarray, positions: np.ndarray) -> None:
        """Measure how far an object has slipped since the platform had gone, as long as both fingers hold it."""
        if candidate.touching(normal[PLATFORM]):
            candidate.lifted_positions = None
        elif candidate.lifted_positions is None:
            candidate.lifted_positions = positions[candidate.gripped_nodes]
        if candidate.touching(normal[:PLATFORM]).all():
            candidate.evaluation.slip_distance = candidate.slip(positions, candidate.lifted_positions)

    def _follow_hold(self, candidate: Candidate, h: float, normal: np.ndarray, fastest: float, elapsed: float) -> bool:
        """Decide after a step whether one grasp has lost or goes on; return whether it has held long enough."""
        remaining = self.options.pickup_hold_time - candidate.holding_time
        touching = candidate.touching(normal[:2]).all()
        on_platform = candidate.touching(normal[2])
        candidate.time_without_contact = 0.0 if touching else candidate.time_without_contact + h
        candidate.holding_time = 0.0 if on_platform else candidate.holding_time + h
        candidate.phase = Phase.LOWER_PLATFORM if on_platform else Phase.HOLD
        still = touching and not on_platform and fastest * remaining < REST_DRIFT * self.model.mesh.size
        candidate.time_at_rest = candidate.time_at_rest + h if still else 0.0
        if candidate.time_without_contact >= LOSS_TIME:
            candidate.evaluation.holding_time = max(0.0, candidate.holding_time - candidate.time_without_contact)
            lost_at = candidate.time - candidate.time_without_contact
            candidate.evaluation.loss_of_contact_time = lost_at - candidate.lowering_began
            side = FINGER_NAMES[int(np.argmin(normal[:2]))] if normal[:2].max() > 0.0 else "both fingers"
            held = candidate.evaluation.holding_time
            when = f"{held:.2f} s after lift-off" if held > 0.0 else "while the platform went down"
            text = f"the object slipped out: {spoken(side)} lost contact {when}"
            self.batch.finish(candidate, ResultCode.DROPPED, text)
        elif on_platform and elapsed > LOWERING_TIME_LIMIT:
            self.batch.finish(candidate, ResultCode.DROPPED, "the object went down with the platform")
        elif touching and not on_platform and (remaining <= h or candidate.time_at_rest >= REST_TIME):
            candidate.evaluation.holding_time = self.options.pickup_hold_time
            return True
        return False

    # --- measurements -------------------------------------------------------------------------------------------

    def _measure_features(self, w: int) -> None:
        candidate, here = self.batch.candidates[w], np.array([w])
        forces = self.simulator.contact_forces(here)[0]
        fingers = forces.fingers()
        state = deformed_state(self.simulator, w)
        candidate.evaluation.contacts = candidate.squeezed_contacts = fingers
        candidate.evaluation.palm_force = forces.force(PALM)
        candidate.evaluation.applied_force = float(self.simulator.normal_forces(here)[0, :2].sum())
        candidate.evaluation.features = grasp_features(
            candidate.grasp,
            self.gripper,
            fingers,
            centre_of_mass(state.positions, self.model.mesh.node_volumes),
            state.opening,
            candidate.opening_at_contact,
            UP,
        )
        if self.batch.keeps_fields():
            candidate.evaluation.fields["at_target_force"] = state
        pads = forces.body < len(FINGER_NAMES)
        candidate.gripped_nodes = np.unique(forces.nodes[pads][forces.weights[pads] > 0.0])
        candidate.gripped_positions = state.positions[candidate.gripped_nodes]

    def _measure_pickup(self, w: int, message: str) -> None:
        candidate, here = self.batch.candidates[w], np.array([w])
        metrics = candidate.evaluation.metrics
        state, forces = deformed_state(self.simulator, w), self.simulator.contact_forces(here)[0]
        stress, energy = self.simulator.point_stresses(here)
        metrics.pickup_success = True
        metrics.max_von_mises_stress = float(state.von_mises_stress.max())
        metrics.max_deformation = float(
            deformation(self.settled.state.positions, state.positions, self.model.mesh.node_volumes).max()
        )
        metrics.strain_energy = float(energy[0].sum())
        error = self.batch.run.stress_recovery.error(stress[0], self.model.material)
        candidate.evaluation.stress_error = error.stress
        candidate.evaluation.deformation_error = error.deformation * metrics.max_deformation
        candidate.evaluation.slip_distance = candidate.slip(state.positions, candidate.lifted_positions)
        candidate.evaluation.contacts, candidate.evaluation.palm_force = forces.fingers(), forces.force(PALM)
        if self.batch.keeps_fields():
            candidate.evaluation.fields["post_pickup"] = state
        self.batch.finish(candidate, ResultCode.OK, message)

    # --- bookkeeping --------------------------------------------------------------------------------------------

    def _drop_finished(self) -> None:
        self.running = np.array([w for w in self.running if not self.batch.candidates[w].finished], dtype=int)

    def _progress(self, phase: Phase, fraction: float) -> None:
        self.batch.progress(Experiment.PICKUP, phase, fraction, len(self.running))
