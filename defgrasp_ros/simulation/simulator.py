"""Many worlds of one deformable object between two pads, over a platform, in front of a palm.

The hand stands still in the object frame; only the pads slide along the closing axis and the platform sinks.
How a step is solved is in :mod:`stepper`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import numpy as np
import warp as wp
from threadpoolctl import ThreadpoolController

from defgrasp_ros.errors import NotFoundError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation import kernels_faces as faces
from defgrasp_ros.simulation.contact_forces import ContactForces
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.kernels_element import element_kernels
from defgrasp_ros.simulation.kernels_progress import TOLERANCE
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.simulation.rows import RowList, Rows
from defgrasp_ros.simulation.shard import Shard, WorldSnapshot
from defgrasp_ros.simulation.shared_compliance import ComplianceCache
from defgrasp_ros.simulation.stepper import StepReport
from defgrasp_ros.simulation.types import mat33d, vec3d
from defgrasp_ros.simulation.world_state import set_entries

_loading = Lock()
"""Held while kernels are loaded."""


class Simulator:
    """State and time stepping of ``world_count`` copies of an object.

    All vectors are in the object frame. ``worlds`` of the methods are indices, shape ``(n,)``. On the CPU the worlds
    are dealt out to one :class:`Shard` per core; world w is the entry w // n of shard w % n.

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
        load_kernels(self._device, model.mesh.element_order)
        rest = RestSystem(model)
        self._constants = DeviceModel(model, gripper, rest.mass, self._device)
        compliances = ComplianceCache(rest, self._device)
        shard_count = 1 if self._device.is_cuda else min(len(os.sched_getaffinity(0)), world_count)
        sizes = [len(range(first, world_count, shard_count)) for first in range(shard_count)]
        self._shards = [Shard(self._constants, compliances, size, self._device) for size in sizes]
        self._threads = ThreadPoolExecutor(shard_count)
        self._blas = ThreadpoolController()
        for shard in self._shards:
            shard.force_scale[:] = model.weight

    def _parts(self, worlds: np.ndarray) -> Iterator[tuple[Shard, np.ndarray, np.ndarray]]:
        """Yield the shards that some worlds are in, the worlds' entries there, and their places in the argument."""
        for first, shard in enumerate(self._shards):
            places = np.flatnonzero(worlds % len(self._shards) == first)
            if len(places):
                yield shard, worlds[places] // len(self._shards), places

    def _collect(self, worlds: np.ndarray, read: Callable[[Shard, np.ndarray], np.ndarray]) -> np.ndarray:
        """Return what ``read`` returns for the worlds, first axis in their order."""
        parts = [(read(shard, entries), places) for shard, entries, places in self._parts(worlds)]
        if not parts:
            return read(self._shards[0], worlds)
        result = np.empty((len(worlds), *parts[0][0].shape[1:]), dtype=parts[0][0].dtype)
        for values, places in parts:
            result[places] = values
        return result

    # --- what the worlds contain --------------------------------------------------------------------------------

    def place_platform(self, worlds: np.ndarray, height: float) -> None:
        """Put the platform's surface at z = ``height`` [m]."""
        for shard, entries, _ in self._parts(worlds):
            set_entries(shard.state.bodies.enabled, (entries, faces.PLATFORM), 1)
            set_entries(shard.state.bodies.base, (entries, faces.PLATFORM), height)

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
        rotation = np.array([g.rotation for g in grasps])
        origin = np.array([g.position for g in grasps])
        x, y, z = rotation[:, :, 0], rotation[:, :, 1], rotation[:, :, 2]
        placed = [(faces.LEFT_PAD, (-y, x, z), 0.0), (faces.RIGHT_PAD, (y, x, z), 0.0)]
        if self.gripper.palm:
            placed.append((faces.PALM, (z, x, y), self.gripper.palm.face))
        for shard, entries, places in self._parts(worlds):
            state, bodies = shard.state, shard.state.bodies
            for body, frame, height in placed:
                base = np.einsum("ij,ij->i", frame[0], origin) + height
                set_entries(bodies.enabled, (entries, body), 1)
                set_entries(bodies.frame, (entries, body), np.stack(frame, axis=1)[places])
                set_entries(bodies.base, (entries, body), base[places])
            set_entries(bodies.origin, entries, origin[places])
            set_entries(bodies.opening, entries, opening[places])
            set_entries(state.start_opening, entries, opening[places])
            set_entries(state.finger_damping, entries, full_force[places] / self.gripper.closing_speed)
            set_entries(state.closing_force, entries, 0.0)
            shard.force_scale[entries] = np.maximum(full_force[places], self.model.weight)

    def set_gravity(self, worlds: np.ndarray, gravity: np.ndarray) -> None:
        """Set the gravity vector [m/s^2], shape ``(3,)`` or ``(n, 3)``."""
        gravity = np.broadcast_to(gravity, (len(worlds), 3))
        for shard, entries, places in self._parts(worlds):
            set_entries(shard.state.gravity, entries, gravity[places])

    def set_spin(self, worlds: np.ndarray, centre: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> None:
        """Let the frame of some worlds turn: their bodies feel Euler's, the centrifugal and Coriolis' force.

        Args:
            worlds: Indices, shape ``(n,)``.
            centre: A point on the axis [m], shape ``(n, 3)``.
            velocity: Angular velocity at the end of the next step [rad/s], shape ``(n, 3)``.
            acceleration: Angular acceleration [rad/s^2], shape ``(n, 3)``.
        """
        for shard, entries, places in self._parts(worlds):
            spin = shard.state.spin
            set_entries(spin.centre, entries, centre[places])
            set_entries(spin.velocity, entries, velocity[places])
            set_entries(spin.acceleration, entries, acceleration[places])

    def set_displacement(self, worlds: np.ndarray, displacement: np.ndarray) -> None:
        """Put the nodes at rest position + displacement [m], shape ``(node, 3)`` or ``(n, node, 3)``; no velocity."""
        displacement = np.broadcast_to(displacement, (len(worlds), self._constants.node_count, 3))
        for shard, entries, places in self._parts(worlds):
            set_entries(shard.state.displacement, entries, displacement[places])
            set_entries(shard.state.start_displacement, entries, displacement[places])
            set_entries(shard.state.start_velocity, entries, 0.0)
            set_entries(shard.state.trend, entries, 0.0)

    def set_velocity(self, worlds: np.ndarray, velocity: np.ndarray) -> None:
        """Give the nodes a velocity [m/s], shape ``(3,)``, ``(node, 3)`` or ``(n, node, 3)``."""
        velocity = np.broadcast_to(velocity, (len(worlds), self._constants.node_count, 3))
        for shard, entries, places in self._parts(worlds):
            set_entries(shard.state.start_velocity, entries, velocity[places])
            set_entries(shard.state.trend, entries, velocity[places])

    def freeze_fingers(self, worlds: np.ndarray) -> None:
        """Hold the fingers where they are, whatever force that takes; ``place_gripper`` frees them."""
        for shard, entries, _ in self._parts(worlds):
            set_entries(shard.state.finger_damping, entries, np.inf)

    def remove_platform(self, worlds: np.ndarray) -> None:
        """Take the platform away."""
        for shard, entries, _ in self._parts(worlds):
            set_entries(shard.state.bodies.enabled, (entries, faces.PLATFORM), 0)

    def save(self, world: int) -> WorldSnapshot:
        """Return all that is known about a world: motion, contacts, bodies, gravity."""
        ((shard, (entry,), _),) = self._parts(np.array([world]))
        return shard.snapshot(entry)

    def load(self, worlds: np.ndarray, snapshots: Sequence[WorldSnapshot]) -> None:
        """Make each world what was saved in the snapshot at its place."""
        for shard, entries, places in self._parts(worlds):
            for entry, place in zip(entries, places, strict=True):
                shard.restore(entry, snapshots[place])

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

        def advance(part: tuple[Shard, np.ndarray, np.ndarray]) -> StepReport:
            shard, entries, places = part
            force, height = closing_force[places], platform_height[places]
            return shard.step(entries, step_length, force, height, quasi_static=quasi_static)

        parts = list(self._parts(worlds))
        # BLAS threads of their own would fight with the shards' threads, and with whatever else runs.
        with self._blas.limit(limits=1, user_api="blas"):
            reports = [advance(parts[0])] if len(parts) == 1 else list(self._threads.map(advance, parts))
        report = StepReport.empty(len(worlds))
        for part, (_, _, places) in zip(reports, parts, strict=True):
            report.put(places, part)
        return report

    # --- what can be seen ---------------------------------------------------------------------------------------

    def positions(self, worlds: np.ndarray) -> np.ndarray:
        """Nodes [m], shape ``(n, node, 3)``."""
        displacement = self._collect(worlds, lambda shard, entries: shard.state.start_displacement.numpy()[entries])
        return self.model.mesh.vertices + displacement

    def velocities(self, worlds: np.ndarray) -> np.ndarray:
        """Nodal velocities [m/s], shape ``(n, node, 3)``; zero after a quasi-static step."""
        return self._collect(worlds, lambda shard, entries: shard.state.start_velocity.numpy()[entries])

    def openings(self, worlds: np.ndarray) -> np.ndarray:
        """Distance of each pad face from the grasp frame's origin [m], shape ``(n,)``."""
        return self._collect(worlds, lambda shard, entries: shard.state.start_opening.numpy()[entries])

    def opening_velocities(self, worlds: np.ndarray) -> np.ndarray:
        """Rate of the opening that the finger law gives for the present forces [m/s], shape ``(n,)``."""
        pads = self.normal_forces(worlds)[:, : faces.PLATFORM].sum(axis=1)
        force = self._collect(worlds, lambda shard, entries: shard.state.closing_force.numpy()[entries])
        damping = self._collect(worlds, lambda shard, entries: shard.state.finger_damping.numpy()[entries])
        return (pads - force) / damping

    def pad_gaps(self, worlds: np.ndarray) -> np.ndarray:
        """How far each pad can close before it touches the surface [m], shape ``(n, 2)``; inf where it never does."""
        reach = 2.0 * self.gripper.max_opening
        return self._collect(worlds, lambda shard, entries: shard.contacts.pad_gaps(self._rows(entries), reach))

    def stresses(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean stress of each element [Pa], ``(n, tet, 3, 3)``, and strain energies [J], ``(n, tet)``.

        The mean of ``point_stresses``, so in the frame that turns with the material.
        """
        stress, energy = self.point_stresses(worlds)
        return stress.mean(axis=2), energy

    def point_stresses(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stress at each quadrature point [Pa], ``(n, tet, point, 3, 3)``, and strain energies [J], ``(n, tet)``.

        One point in an element of order 1, four in one of order 2. The tensors are in the points' rotated frames: they
        turn with the material.
        """
        model, count = self._constants, len(worlds)
        stress = wp.zeros((count, model.tet_count * model.point_count), dtype=mat33d, device=self._device)
        density = wp.zeros((count, model.tet_count), dtype=wp.float64, device=self._device)
        rows, displacement = self._displacement_rows(worlds)
        inputs = [rows, model.elements, model.gradients, model.lame, displacement]
        wp.launch(
            model.kernels.stresses, dim=density.shape, inputs=inputs, outputs=[stress, density], device=self._device
        )
        tensors = stress.numpy().reshape(count, model.tet_count, model.point_count, 3, 3)
        return tensors, density.numpy() * self.model.mesh.volumes

    def elastic_forces(self, worlds: np.ndarray) -> np.ndarray:
        """Elastic force on each node [N], shape ``(n, node, 3)``."""
        model, count = self._constants, len(worlds)
        rows, displacement = self._displacement_rows(worlds)
        rotation = wp.zeros((count, model.tet_count), dtype=mat33d, device=self._device)
        force = wp.zeros((count, model.entry_count), dtype=vec3d, device=self._device)
        inputs = [rows, model.elements, model.gradients, model.volumes, model.lame, displacement]
        wp.launch(
            model.kernels.forces, dim=rotation.shape, inputs=inputs, outputs=[rotation, force], device=self._device
        )
        total = np.zeros((count, model.node_count, 3))
        for row, entries in enumerate(force.numpy()):
            np.add.at(total[row], self.model.mesh.elements.ravel(), entries)
        return total

    def _displacement_rows(self, worlds: np.ndarray) -> tuple[Rows, wp.array]:
        """Rows and displacements of some worlds for the element kernels."""
        displacement = self.positions(worlds) - self.model.mesh.vertices
        return self._rows(np.arange(len(worlds))).device, wp.array(displacement, dtype=vec3d, device=self._device)

    def normal_forces(self, worlds: np.ndarray) -> np.ndarray:
        """Force of left pad, right pad, platform and palm along their faces' normals [N], shape ``(n, 4)``.

        The sum of both pads is what balances the closing force.
        """
        return self._collect(worlds, lambda shard, entries: shard.contacts.normal_forces(entries))

    def contact_forces(self, worlds: np.ndarray) -> list[ContactForces]:
        """The contact points that carry more force than the solver's tolerance, per world."""
        result: dict[int, ContactForces] = {}
        for shard, entries, places in self._parts(worlds):
            positions = self.positions(worlds[places])
            for entry, place, nodes in zip(entries, places, positions, strict=True):
                threshold = TOLERANCE * shard.force_scale[entry]
                result[place] = shard.contacts.loaded(entry, nodes, threshold)
        return [result[place] for place in range(len(worlds))]

    def _rows(self, entries: np.ndarray) -> RowList:
        return RowList(len(entries), self._device).assign(entries)


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


def device_names() -> list[str]:
    """Return the names of the devices of this machine."""
    wp.init()
    return [device.alias for device in wp.get_devices()]


def prepare_device(name: str) -> None:
    """Compile, or load, all that a simulation runs on a device.

    Raises:
        NotFoundError: If the machine has no device of that name.
    """
    device = find_device(name)
    for element_order in REFERENCE_ELEMENTS:
        load_kernels(device, element_order)


def load_kernels(device: wp.Device, element_order: int) -> None:
    """Compile, or load, all that a simulation with such elements runs on a device.

    Warp loads modules without a lock. Two threads that launch the first kernel of a module at once would each load it,
    and what one of them has recorded would point to code that is gone. So nothing may be left for them to load.
    """
    with _loading:
        wp.load_module(__package__, device=device, recursive=True)
        element_kernels(element_order).load(device)
