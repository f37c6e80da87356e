"""Many worlds of one deformable object between two pads, over a platform, in front of a palm.

The hand stands still in the object frame; only the pads slide along the closing axis and the platform sinks.
How a step is solved is in :mod:`stepper`.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from defgrasp_ros.errors import NotFoundError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation import kernels_elasticity as elastic
from defgrasp_ros.simulation import kernels_faces as faces
from defgrasp_ros.simulation.contact_forces import ContactForces
from defgrasp_ros.simulation.contact_set import ContactSet
from defgrasp_ros.simulation.dense import algebra_for
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.simulation.shared_compliance import ComplianceCache
from defgrasp_ros.simulation.stepper import TOLERANCE, Stepper, StepReport
from defgrasp_ros.simulation.types import mat33d, mat43d
from defgrasp_ros.simulation.world_state import WorldState, set_entries

STEP_CUT = 4
"""Number of smaller steps that replace one that did not converge."""
MAX_CUTS = 2
"""How often a step may be cut before its world is given up."""


class Simulator:
    """State and time stepping of ``world_count`` copies of an object.

    All vectors are in the object frame. ``worlds`` of the methods are indices, shape ``(n,)``.

    Args:
        model: The object and its material.
        gripper: The pads.
        world_count: Number of worlds.
        device: Warp device, e.g. ``"cpu"`` or ``"cuda:0"``.

    Raises:
        NotFoundError: If there is no such device.
        InvalidMeshError: If the mesh has no usable stiffness.
    """

    def __init__(self, model: ObjectModel, gripper: Gripper, world_count: int, device: str = "cpu"):
        self.model = model
        self.gripper = gripper
        self.world_count = world_count
        self._device = find_device(device)
        algebra = algebra_for(self._device)
        rest = RestSystem(model)
        self._compliances = ComplianceCache(rest, self._device)
        self._constants = DeviceModel(model, gripper, rest.mass, self._device)
        self._state = WorldState(world_count, self._constants.node_count, self._device)
        self._contacts = ContactSet(self._constants, self._state, world_count, model.mesh.size, self._device, algebra)
        self._stepper = Stepper(self._constants, self._state, self._contacts, world_count, self._device, algebra)
        self._force_scale = np.full(world_count, model.weight)

    # --- what the worlds contain --------------------------------------------------------------------------------

    def place_platform(self, worlds: np.ndarray, height: float) -> None:
        """Put the platform's surface at z = ``height`` [m]."""
        set_entries(self._state.bodies.enabled, (worlds, faces.PLATFORM), 1)
        set_entries(self._state.bodies.base, (worlds, faces.PLATFORM), height)

    def place_gripper(
        self, worlds: np.ndarray, grasps: list[Grasp], opening: np.ndarray, full_force: np.ndarray
    ) -> None:
        """Put the gripper into some worlds, one grasp each.

        Args:
            worlds: Indices, shape ``(n,)``.
            grasps: Pose of the gripper in each of them.
            opening: Distance of each pad face from the grasp frame's origin [m], shape ``(n,)``.
            full_force: Closing force with which free fingers move at the gripper's closing speed [N], shape ``(n,)``.
        """
        state, bodies = self._state, self._state.bodies
        rotation = np.array([g.rotation for g in grasps])
        origin = np.array([g.position for g in grasps])
        x, y, z = rotation[:, :, 0], rotation[:, :, 1], rotation[:, :, 2]
        placed = [(faces.LEFT_PAD, (-y, x, z), 0.0), (faces.RIGHT_PAD, (y, x, z), 0.0)]
        if self.gripper.palm:
            placed.append((faces.PALM, (z, x, y), self.gripper.palm.face))
        for body, frame, height in placed:
            set_entries(bodies.enabled, (worlds, body), 1)
            set_entries(bodies.frame, (worlds, body), np.stack(frame, axis=1))
            set_entries(bodies.base, (worlds, body), np.einsum("ij,ij->i", frame[0], origin) + height)
        set_entries(bodies.origin, worlds, origin)
        set_entries(bodies.opening, worlds, opening)
        set_entries(state.start_opening, worlds, opening)
        set_entries(state.finger_damping, worlds, full_force / self.gripper.closing_speed)
        set_entries(state.closing_force, worlds, 0.0)
        self._force_scale[worlds] = np.maximum(full_force, self.model.weight)

    def set_gravity(self, worlds: np.ndarray, gravity: np.ndarray) -> None:
        """Set the gravity vector [m/s^2]."""
        set_entries(self._state.gravity, worlds, gravity)

    def set_displacement(self, worlds: np.ndarray, displacement: np.ndarray) -> None:
        """Put the nodes at rest position + displacement [m], without velocity."""
        set_entries(self._state.displacement, worlds, displacement)
        set_entries(self._state.start_displacement, worlds, displacement)
        set_entries(self._state.start_velocity, worlds, 0.0)

    def set_velocity(self, worlds: np.ndarray, velocity: np.ndarray) -> None:
        """Give all nodes a velocity [m/s]."""
        set_entries(self._state.start_velocity, worlds, velocity)

    def copy_world(self, source: int, worlds: np.ndarray) -> None:
        """Give some worlds the motion and the contacts of another."""
        state = self._state
        for array in (state.displacement, state.start_displacement, state.start_velocity, state.rotation):
            set_entries(array, worlds, array.numpy()[source])
        self._contacts.copy_world(source, worlds)

    # --- stepping -----------------------------------------------------------------------------------------------

    def step(
        self,
        worlds: np.ndarray,
        step_length: float,
        closing_force: np.ndarray,
        platform_height: np.ndarray,
        *,
        quasi_static: bool,
    ) -> StepReport:
        """Advance some worlds by one step; one that does not converge is advanced in smaller steps.

        A world that does not converge either way keeps its last good state.

        Args:
            worlds: Indices, shape ``(n,)``.
            step_length: h [s].
            closing_force: F at the end of the step [N], shape ``(n,)``.
            platform_height: At the end of the step [m], shape ``(n,)``.
            quasi_static: Whether the velocity is forgotten after the step, so that only mass / h^2 resists.
        """
        state = self._state
        start_force = state.closing_force.numpy()[worlds].copy()
        start_height = state.platform_heights(worlds)

        def advance(some: np.ndarray, pieces: int, piece: int) -> StepReport:
            """Take one of several equal pieces of the step."""
            share = piece / pieces
            set_entries(
                state.closing_force, worlds[some], start_force[some] + share * (closing_force - start_force)[some]
            )
            heights = start_height[some] + share * (platform_height - start_height)[some]
            set_entries(state.bodies.base, (worlds[some], faces.PLATFORM), heights)
            compliance = self._compliances[step_length / pieces]
            scale = self._force_scale[worlds[some]]
            return self._stepper.step(worlds[some], compliance, scale, quasi_static=quasi_static)

        report = advance(np.arange(len(worlds)), 1, 1)
        for cut in range(1, MAX_CUTS + 1):
            failed = np.flatnonzero(~report.converged)
            if not len(failed):
                break
            self._advance_in_pieces(worlds, failed, cut, advance, report)
        bad = ~report.converged
        set_entries(state.closing_force, worlds[bad], start_force[bad])
        set_entries(state.bodies.base, (worlds[bad], faces.PLATFORM), start_height[bad])
        return report

    def _advance_in_pieces(self, worlds: np.ndarray, failed: np.ndarray, cut: int, advance, report: StepReport) -> None:
        """Repeat a step in smaller ones where it failed; a world that fails again goes back to where it began."""
        pieces = STEP_CUT**cut
        before = [array.numpy()[worlds[failed]].copy() for array in self._state.motion]
        report.cuts[failed] = cut
        report.residual[failed] = 0.0
        report.converged[failed] = True
        for piece in range(1, pieces + 1):
            good = failed[report.converged[failed]]
            if not len(good):
                break
            part = advance(good, pieces, piece)
            report.converged[good] = part.converged
            report.iterations[good] += part.iterations
            report.contact_fallbacks[good] += part.contact_fallbacks
            report.residual[good] = np.maximum(report.residual[good], part.residual)
        lost = ~report.converged[failed]
        for array, values in zip(self._state.motion, before, strict=True):
            set_entries(array, worlds[failed[lost]], values[lost])

    # --- what can be seen ---------------------------------------------------------------------------------------

    def positions(self, worlds: np.ndarray) -> np.ndarray:
        """Nodes [m], shape ``(n, node, 3)``."""
        return self.model.mesh.vertices + self._state.start_displacement.numpy()[worlds]

    def velocities(self, worlds: np.ndarray) -> np.ndarray:
        """Nodal velocities [m/s], shape ``(n, node, 3)``; zero after a quasi-static step."""
        return self._state.start_velocity.numpy()[worlds]

    def openings(self, worlds: np.ndarray) -> np.ndarray:
        """Distance of each pad face from the grasp frame's origin [m], shape ``(n,)``."""
        return self._state.start_opening.numpy()[worlds]

    def opening_velocities(self, worlds: np.ndarray) -> np.ndarray:
        """Rate of the opening that the finger law gives for the present forces [m/s], shape ``(n,)``."""
        pads = self.normal_forces(worlds)[:, : faces.PLATFORM].sum(axis=1)
        return (pads - self._state.closing_force.numpy()[worlds]) / self._state.finger_damping.numpy()[worlds]

    def pad_gaps(self, worlds: np.ndarray) -> np.ndarray:
        """How far each pad can close before it touches the surface [m], shape ``(n, 2)``; inf where it never does."""
        rows = wp.array(worlds, dtype=int, device=self._device)
        return self._contacts.pad_gaps(rows, reach=2.0 * self.gripper.max_opening)

    def stresses(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stress tensors in the elements' frames [Pa], ``(n, tet, 3, 3)``, and strain energies [J], ``(n, tet)``."""
        model, shape = self._constants, (len(worlds), self._constants.tet_count)
        stress = wp.zeros(shape, dtype=mat33d, device=self._device)
        density = wp.zeros(shape, dtype=wp.float64, device=self._device)
        rows = wp.array(worlds, dtype=int, device=self._device)
        inputs = [model.tetrahedra, model.gradients, model.lame, rows, self._state.start_displacement]
        wp.launch(elastic.element_stress, dim=shape, inputs=inputs, outputs=[stress, density], device=self._device)
        return stress.numpy(), density.numpy() * self.model.mesh.volumes

    def elastic_forces(self, worlds: np.ndarray) -> np.ndarray:
        """Elastic force on each node [N], shape ``(n, node, 3)``."""
        model, shape = self._constants, (len(worlds), self._constants.tet_count)
        rotation = wp.zeros(shape, dtype=mat33d, device=self._device)
        force = wp.zeros(shape, dtype=mat43d, device=self._device)
        rows = wp.array(worlds, dtype=int, device=self._device)
        inputs = [model.tetrahedra, model.gradients, model.volumes, model.lame, rows, self._state.start_displacement]
        wp.launch(elastic.element_forces, dim=shape, inputs=inputs, outputs=[rotation, force], device=self._device)
        total = np.zeros((len(worlds), model.node_count, 3))
        for row, corners in enumerate(force.numpy()):
            np.add.at(total[row], self.model.mesh.tetrahedra, corners)
        return total

    def normal_forces(self, worlds: np.ndarray) -> np.ndarray:
        """Force of left pad, right pad, platform and palm along their faces' normals [N], shape ``(n, 4)``.

        The sum of both pads is what balances the closing force.
        """
        return self._contacts.normal_forces(worlds)

    def contact_forces(self, worlds: np.ndarray) -> list[ContactForces]:
        """The contact points that carry more force than the solver's tolerance, per world."""
        lists = self._contacts.lists
        count, body = lists.count.numpy(), lists.body.numpy()
        nodes, weights, force = lists.nodes.numpy(), lists.weights.numpy(), lists.force.numpy()
        frames = lists.frame.numpy()
        result = []
        for w, positions in zip(worlds, self.positions(worlds), strict=True):
            loaded = np.flatnonzero(force[w, : count[w], 0] > TOLERANCE * self._force_scale[w])
            frame = frames[w, loaded]
            result.append(
                ContactForces(
                    body=body[w, loaded],
                    positions=np.einsum("ck,ckj->cj", weights[w, loaded], positions[nodes[w, loaded]]),
                    normals=frame[:, 0],
                    forces=np.einsum("cij,ci->cj", frame, force[w, loaded]),
                    nodes=nodes[w, loaded],
                    weights=weights[w, loaded],
                    friction=self.model.material.friction_coefficient,
                )
            )
        return result


def find_device(name: str) -> wp.Device:
    """Return the Warp device of that name.

    Raises:
        NotFoundError: If the machine has none.
    """
    wp.init()
    try:
        return wp.get_device(name)
    except ValueError:
        known = ", ".join(device.alias for device in wp.get_devices())
        raise NotFoundError(f"device = '{name}' is not available; this machine has: {known}") from None
