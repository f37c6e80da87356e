"""The contact points of all worlds: finding them, their compliance, their forces and their residual."""

from __future__ import annotations

import numpy as np
import warp as wp

from defgrasp_ros.simulation import kernels_contact as contact
from defgrasp_ros.simulation import kernels_coulomb as coulomb
from defgrasp_ros.simulation import kernels_detection as detection
from defgrasp_ros.simulation import kernels_faces as faces
from defgrasp_ros.simulation import kernels_selection as selection
from defgrasp_ros.simulation.contact_forces import ContactForces
from defgrasp_ros.simulation.contact_solver import ContactSolver
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.kernels_block_matrix import half_size
from defgrasp_ros.simulation.shared_compliance import SharedCompliance
from defgrasp_ros.simulation.types import mat33d, vec3d
from defgrasp_ros.simulation.world_state import WorldState, clear_rows, set_entries

wp.set_module_options({"enable_backward": False})

INITIAL_CAPACITY = 32
"""Contact points per world; grows in steps of this."""
MARGIN = 1e-2
"""Gap below which a point becomes a candidate, relative to the mean surface edge [-]."""
PENETRATION = 5e-5
"""Depth of an unlisted point that makes a step look for contacts again, relative to the object's size [-]."""
DEEP = 2e-3
"""Depth behind a face at which a point cannot be by the front, relative to the object's size [-]: far above what a
solved step leaves."""
TIE = 1e-5
"""Difference of gaps that does not decide between two points, relative to the object\'s size [-]."""
CONTACT_FIELDS = ("key", "body", "nodes", "weights", "frame", "plane", "axis", "force", "trend")


class ContactSet:
    """Candidate points with their forces, and the contact problem that they pose.

    ``rows`` of the methods are lists of worlds on the device; work buffers have one row per entry.
    """

    def __init__(
        self,
        model: DeviceModel,
        state: WorldState,
        world_count: int,
        device: wp.Device,
    ):
        self._model = model
        self._state = state
        self._world_count = world_count
        self._device = device
        self._margin = MARGIN * model.mean_edge
        self._penetration = PENETRATION * model.size
        self._normal = wp.zeros((world_count, model.node_count), dtype=vec3d, device=device)
        self._places = wp.zeros((world_count, model.node_count), dtype=int, device=device)
        feature_count = sum(len(a) for a in (model.surface.nodes, model.surface.edges, model.surface.triangles))
        chunk_count = -(-feature_count // detection.CHUNK)
        self._near = wp.zeros((world_count, faces.BODY_COUNT, chunk_count), dtype=wp.uint64, device=device)
        self._no_correction = wp.zeros((world_count, model.node_count), dtype=vec3d, device=device)
        self._missing = wp.zeros(world_count, dtype=int, device=device)
        self._residual = wp.zeros(world_count, dtype=wp.float64, device=device)
        self.stale = wp.ones(world_count, dtype=int, device=device)
        """Worlds whose compliance must be assembled anew."""
        self._assembled_step = np.zeros(world_count)
        self._allocate(INITIAL_CAPACITY)

    def _allocate(self, capacity: int) -> None:
        worlds, device = self._world_count, self._device
        self.capacity = capacity
        self.lists, self._remembered, self._found, self._merged = (
            self._contact_list(worlds, capacity) for _ in range(4)
        )
        self._proposed = self._contact_list(faces.BODY_COUNT * worlds, capacity)
        self._proposed_gap = wp.zeros((faces.BODY_COUNT * worlds, capacity), dtype=wp.float64, device=device)
        self._owned = wp.zeros((faces.BODY_COUNT * worlds, capacity), dtype=int, device=device)
        self._gap = wp.zeros((worlds, capacity), dtype=wp.float64, device=device)
        self._force = wp.zeros((worlds, capacity), dtype=vec3d, device=device)
        self._motion = wp.zeros((worlds, capacity), dtype=vec3d, device=device)
        self._rho = wp.zeros(worlds, dtype=wp.float64, device=device)
        self._problems = coulomb.ContactProblems()
        self._problems.count, self._problems.rho = self.lists.count, self._rho
        self._problems.friction = self._model.friction
        self._problems.matrix = wp.zeros((worlds, half_size(capacity)), dtype=mat33d, device=device)
        self._problems.force, self._problems.motion = self._force, self._motion
        self._solver = ContactSolver(worlds, capacity, device)
        self.stale.fill_(1)

    def _grow(self, count: int) -> None:
        """Make room for ``count`` points per world, keeping the lists."""
        kept = self.lists, self._remembered
        self._allocate(INITIAL_CAPACITY * -(-count // INITIAL_CAPACITY))
        every = wp.array(np.arange(self._world_count), dtype=int, device=self._device)
        for source, target in zip(kept, (self.lists, self._remembered), strict=True):
            self._launch(contact.copy_contacts, self._world_count, [every, source, target])

    def _contact_list(self, rows: int, capacity: int) -> contact.ContactList:
        shape, result = (rows, capacity), contact.ContactList()
        result.count = wp.zeros(rows, dtype=int, device=self._device)
        result.key = wp.zeros(shape, dtype=int, device=self._device)
        result.body = wp.zeros(shape, dtype=int, device=self._device)
        result.nodes = wp.zeros(shape, dtype=wp.vec3i, device=self._device)
        result.weights = wp.zeros(shape, dtype=vec3d, device=self._device)
        result.frame = wp.zeros(shape, dtype=mat33d, device=self._device)
        result.plane = wp.zeros(shape, dtype=wp.float64, device=self._device)
        result.axis = wp.zeros(shape, dtype=vec3d, device=self._device)
        result.force = wp.zeros(shape, dtype=vec3d, device=self._device)
        result.trend = wp.zeros(shape, dtype=vec3d, device=self._device)
        return result

    def remember(self, rows: wp.array) -> None:
        """Keep the lists of some worlds, to go back to them."""
        self._launch(contact.copy_contacts, rows.shape[0], [rows, self.lists, self._remembered])

    def go_back(self, rows: wp.array) -> None:
        """Take the lists that were last remembered, without their trends: they may have led astray."""
        self._launch(contact.copy_contacts, rows.shape[0], [rows, self._remembered, self.lists])
        self.forget_trends(rows)
        set_entries(self.stale, rows.numpy(), 1)

    def extrapolate(self, rows: wp.array, step_length: float) -> None:
        """Let the forces go on as in the step before: a first guess."""
        self._launch(contact.extrapolate_forces, (rows.shape[0], self.capacity), [rows, step_length, self.lists])

    def find_trends(self, rows: wp.array, step_length: float) -> None:
        """Note what the step since ``remember`` changed."""
        self._launch(contact.find_trends, rows.shape[0], [rows, step_length, self._remembered, self.lists])

    def forget_trends(self, rows: wp.array) -> None:
        """Let the forces of some worlds stay as they are in the next first guess."""
        clear_rows(self.lists.trend, rows)

    # --- finding points -----------------------------------------------------------------------------------------

    def find(self, rows: wp.array) -> None:
        """List the candidates at the present displacement; a point found again keeps its force."""
        self._search(rows, self._margin)
        self._carry_forces(rows, self.stale)
        self._launch(contact.copy_contacts, rows.shape[0], [rows, self._found, self.lists])

    def complete(self, rows: wp.array) -> np.ndarray:
        """Add points that are deep inside a body and not listed; return in which rows there were any."""
        while True:
            self._search(rows, -self._penetration)
            worlds = rows.numpy()
            room = (self.lists.count.numpy()[worlds] + self._found.count.numpy()[worlds]).max(initial=0)
            if room <= self.capacity:
                break
            self._grow(room)
        self._carry_forces(rows, wp.zeros_like(self.stale))
        missing = self._missing.numpy()[: len(worlds)] > 0
        if missing.any():
            some = wp.array(worlds[missing], dtype=int, device=self._device)
            self._launch(
                contact.merge_contacts, some.shape[0], [some, self.lists, self._found], [self._merged, self.stale]
            )
            self._launch(contact.copy_contacts, some.shape[0], [some, self._merged, self.lists])
        return missing

    def _search(self, rows: wp.array, margin: float) -> None:
        """Fill the list of found points, which grows as needed."""
        scene = self._scene(self._state.displacement, margin)
        self._screen(scene, rows)
        while True:
            needed = self._propose(scene, rows, self._proposed, self._proposed_gap)
            if needed <= self.capacity:
                inputs = [scene, rows, self._proposed, self._proposed_gap]
                self._launch(selection.drop_dependent, (rows.shape[0], faces.BODY_COUNT), inputs, [self._owned])
                inputs = [self._proposed, self._proposed_gap, rows]
                self._launch(selection.join_bodies, rows.shape[0], inputs, [self._found, self._gap])
                needed = int(self._found.count.numpy()[rows.numpy()].max(initial=0))
            if needed <= self.capacity:
                return
            self._grow(needed)

    def pad_gaps(self, rows: wp.array, reach: float) -> np.ndarray:
        """Return how far each pad can close before it touches the surface in front of it [m], shape ``(row, 2)``.

        It is inf where there is none within ``reach`` [m].
        """
        scene = self._scene(self._state.start_displacement, reach)
        scene.deep = np.inf
        self._screen(scene, rows)
        capacity = 0
        while True:
            row_count = faces.BODY_COUNT * rows.shape[0]
            every = self._contact_list(row_count, capacity)
            gap = wp.zeros((row_count, capacity), dtype=wp.float64, device=self._device)
            needed = self._propose(scene, rows, every, gap)
            if needed <= capacity:
                break
            capacity = needed
        listed = (np.arange(capacity) < every.count.numpy()[:, None]) & (every.key.numpy() >= 0)
        smallest = np.where(listed, gap.numpy(), np.inf).min(axis=1, initial=np.inf)
        return smallest.reshape(-1, faces.BODY_COUNT)[:, [faces.LEFT_PAD, faces.RIGHT_PAD]]

    def _scene(self, displacement: wp.array, margin: float) -> detection.Scene:
        scene, model = detection.Scene(), self._model
        scene.surface, scene.faces, scene.bodies = model.surface, model.faces, self._state.bodies
        scene.rest, scene.displacement = model.vertices, displacement
        scene.start_displacement = self._state.start_displacement
        scene.margin, scene.tie, scene.deep = margin, TIE * model.size, DEEP * model.size
        scene.normal, scene.places, scene.listed = self._normal, self._places, self.lists
        return scene

    def _screen(self, scene: detection.Scene, rows: wp.array) -> None:
        """Mark the features of the surface that can be nearer to a body than the margin."""
        count = rows.shape[0]
        self._launch(detection.look_at_nodes, (count, len(scene.surface.nodes)), [scene, rows])
        self._launch(detection.screen_features, (count, self._near.shape[2]), [scene, rows], [self._near])

    def _propose(self, scene: detection.Scene, rows: wp.array, proposed: contact.ContactList, gap: wp.array) -> int:
        """List the candidates of each world and body; return how much room the longest list needs."""
        dim = (rows.shape[0], faces.BODY_COUNT)
        inputs = [scene, self._near, rows]
        self._launch(detection.propose_contacts, dim, inputs, [proposed, gap])
        return int(proposed.count.numpy()[: dim[0] * dim[1]].max(initial=0))

    def _carry_forces(self, rows: wp.array, stale: wp.array) -> None:
        scene = self._scene(self._state.displacement, self._margin)
        inputs = [scene, rows, self.lists, self._gap]
        self._launch(selection.carry_forces, rows.shape[0], inputs, [self._found, stale, self._missing])

    # --- compliance ---------------------------------------------------------------------------------------------

    def expect_step(self, worlds: np.ndarray, step_length: float) -> None:
        """The next compliance is for steps of this length [s]."""
        set_entries(self.stale, worlds[self._assembled_step[worlds] != step_length], 1)

    def refresh_compliance(self, rows: wp.array, shared: SharedCompliance) -> None:
        """Assemble W anew where the points, the rotations or the step length changed."""
        worlds, state = rows.numpy(), self._state
        stale = worlds[self.stale.numpy()[worlds] != 0]
        if not len(stale):
            return
        some, lists = wp.array(stale, dtype=int, device=self._device), self.lists
        inputs = [lists.count, lists.nodes, lists.weights, shared.elastic, some]
        self._launch(coulomb.estimate_rho, len(stale), inputs, [self._rho])
        self._launch(
            contact.assemble_contact_compliance,
            (len(stale), self.capacity, self.capacity),
            [shared.matrix, shared.step_length, lists, some, state.rotation, state.finger_damping],
            [self._problems.matrix],
        )
        self._solver.forget(stale)
        set_entries(self.stale, stale, 0)
        self._assembled_step[stale] = shared.step_length

    # --- forces -------------------------------------------------------------------------------------------------

    def add_forces(self, rows: wp.array, nodal_force: wp.array) -> None:
        """Add the contact forces to nodal forces (row, node) [N]."""
        self._launch(contact.gather_forces, (rows.shape[0], self.capacity), [rows, self.lists], [self._force])
        self._scatter(rows, nodal_force)

    def residual(self, rows: wp.array) -> np.ndarray:
        """Return how far each row's worst contact is from its law [N], shape ``(row,)``; after ``add_forces``."""
        self._relative_motion(rows, self._no_correction)
        inputs = [self.lists.count, rows, self._model.friction, self._rho, self._force, self._motion]
        self._launch(coulomb.contact_residual, rows.shape[0], inputs, [self._residual])
        return self._residual.numpy()[: rows.shape[0]]

    def solve(self, rows: wp.array, correction: wp.array, tolerance: np.ndarray) -> np.ndarray:
        """Find the forces that obey the contact laws at displacement + correction; return which rows were hard.

        Args:
            rows: Worlds.
            correction: Nodal correction that would follow without a change of forces (row, node) [m].
            tolerance: Largest residual [N], shape ``(row,)``.
        """
        self._relative_motion(rows, correction)
        problems, solver, places = self._problems, self._solver, (rows.shape[0], self.capacity)
        problems.worlds = rows
        solver.solve(problems, wp.array(tolerance, dtype=wp.float64, device=self._device))
        self._launch(contact.take_forces, places, [rows, solver.force, self.lists, self._force])
        return solver.attempts.numpy()[: len(tolerance)] > 1

    def add_force_change(self, rows: wp.array, nodal_force: wp.array) -> None:
        """Add what the last ``solve`` changed in the contact forces to nodal forces (row, node) [N]."""
        self._scatter(rows, nodal_force)

    def snapshot(self, world: int) -> dict[str, np.ndarray]:
        """Return the points and forces of a world, on the host."""
        count = self.lists.count.numpy()[world]
        return {name: getattr(self.lists, name).numpy()[world, :count].copy() for name in CONTACT_FIELDS}

    def restore(self, world: int, snapshot: dict[str, np.ndarray]) -> None:
        """Give a world the points and forces that another had."""
        count = len(snapshot["key"])
        if count > self.capacity:
            self._grow(count)
        set_entries(self.lists.count, world, count)
        for name, values in snapshot.items():
            set_entries(getattr(self.lists, name), (world, slice(count)), values)
        set_entries(self.stale, world, 1)

    def normal_forces(self, worlds: np.ndarray) -> np.ndarray:
        """Force of each body along the normal of its face [N], shape ``(n, body)``.

        That of a pad is along the closing axis, with what friction and normals in the fillets contribute to it.
        """
        count, body = self.lists.count.numpy()[worlds], self.lists.body.numpy()[worlds]
        force = np.einsum("ncj,ncj->nc", self.lists.axis.numpy()[worlds], self.lists.force.numpy()[worlds])
        listed = np.arange(self.capacity) < count[:, None]
        bodies = range(faces.BODY_COUNT)
        return np.stack([np.where(listed & (body == b), force, 0.0).sum(axis=1) for b in bodies], axis=1)

    def loaded(self, world: int, positions: np.ndarray, threshold: float) -> ContactForces:
        """The points of a world that carry more than ``threshold`` [N]; nodes are at ``positions`` [m]."""
        lists = self.lists
        force = lists.force.numpy()[world, : lists.count.numpy()[world]]
        points = np.flatnonzero(force[:, 0] > threshold)
        body, nodes, weights = (array.numpy()[world, points] for array in (lists.body, lists.nodes, lists.weights))
        frame = lists.frame.numpy()[world, points]
        return ContactForces(
            body=body,
            positions=np.einsum("ck,ckj->cj", weights, positions[nodes]),
            normals=frame[:, 0],
            forces=np.einsum("cij,ci->cj", frame, force[points]),
            nodes=nodes,
            weights=weights,
            friction=self._model.friction,
        )

    def _scatter(self, rows: wp.array, nodal_force: wp.array) -> None:
        inputs = [self.lists, rows, self._force, nodal_force]
        self._launch(contact.scatter_contact_forces, rows.shape[0], inputs)

    def _relative_motion(self, rows: wp.array, correction: wp.array) -> None:
        state = self._state
        inputs = [
            self._model.vertices,
            state.bodies,
            self.lists,
            rows,
            state.start_displacement,
            state.displacement,
            correction,
        ]
        self._launch(contact.relative_motion, (rows.shape[0], self.capacity), inputs, [self._motion])

    def _launch(self, kernel, dim, inputs: list, outputs: list | None = None) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs or [], device=self._device)
