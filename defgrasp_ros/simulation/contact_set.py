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
from defgrasp_ros.simulation.rows import Launcher, RowList
from defgrasp_ros.simulation.shared_compliance import SharedCompliance
from defgrasp_ros.simulation.types import mat33d, vec3d
from defgrasp_ros.simulation.world_state import WorldState, set_entries

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
"""Difference of gaps that does not decide between two points, relative to the object's size [-]."""
CONTACT_FIELDS = ("key", "body", "nodes", "weights", "frame", "plane", "axis", "force", "trend")


class ContactSet:
    """Candidate points with their forces, and the contact problem that they pose.

    ``rows`` of the methods are the worlds that they are about.
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
        self.missing, self.longest = (wp.zeros(size, dtype=int, device=device) for size in (world_count, 1))
        """Unlisted points inside a body that ``complete`` found per world, and the room of the longest list."""
        self.residual = wp.zeros(world_count, dtype=wp.float64, device=device)
        """How far the worst contact of each world is from its law [N], of ``find_residual``."""
        self._rho, self._assembled_step = (wp.zeros(world_count, dtype=wp.float64, device=device) for _ in range(2))
        self._stale_rows = RowList(world_count, device)
        self._every_row = RowList(world_count, device).assign(np.arange(world_count))
        self.stale = wp.ones(world_count, dtype=int, device=device)
        """Worlds whose compliance must be assembled anew."""
        self._allocate(INITIAL_CAPACITY)

    def _allocate(self, capacity: int) -> None:
        worlds, device = self._world_count, self._device
        self.capacity = capacity
        self._launch = Launcher(device)
        self.lists, self._remembered, self._found, self._merged = (
            self._contact_list(worlds, capacity) for _ in range(4)
        )
        self._proposed = self._contact_list(faces.BODY_COUNT * worlds, capacity)
        self._proposed_gap = wp.zeros((faces.BODY_COUNT * worlds, capacity), dtype=wp.float64, device=device)
        self._owned = wp.zeros((faces.BODY_COUNT * worlds, capacity), dtype=int, device=device)
        self._gap = wp.zeros((worlds, capacity), dtype=wp.float64, device=device)
        self._force, self._motion = (wp.zeros((worlds, capacity), dtype=vec3d, device=device) for _ in range(2))
        self._problems = coulomb.ContactProblems()
        self._problems.count, self._problems.rho = self.lists.count, self._rho
        self._problems.friction = self._model.friction
        self._problems.matrix = wp.zeros((worlds, half_size(capacity)), dtype=mat33d, device=device)
        self._problems.force, self._problems.motion = self._force, self._motion
        self._solver = ContactSolver(worlds, capacity, device)
        self._candidates = self._scene(self._margin)
        self._overlooked = self._scene(-self._penetration)
        self.stale.fill_(1)

    def _grow(self, count: int) -> None:
        """Make room for ``count`` points per world, keeping the lists."""
        kept = self.lists, self._remembered
        self._allocate(INITIAL_CAPACITY * -(-count // INITIAL_CAPACITY))
        for source, target in zip(kept, (self.lists, self._remembered), strict=True):
            self._copy(self._every_row, source, target)

    def begin_anew(self, rows: RowList, longest: int) -> None:
        """Make room for the longest list, and go back to where the step of some worlds began."""
        self._grow(longest)
        self._copy(rows, self._remembered, self.lists)

    def _copy(self, rows: RowList, source: contact.ContactList, target: contact.ContactList) -> None:
        self._launch(contact.copy_contacts, (rows,), [self.longest, source, target])

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

    def remember(self, rows: RowList, step_length: float) -> None:
        """Keep the lists of some worlds, to go back to them, before a step of a length [s]."""
        inputs = [step_length, self._assembled_step, self.lists, self._remembered, self.stale]
        self._launch(contact.remember_contacts, (rows,), inputs)

    def go_back(self, rows: RowList) -> None:
        """Take the lists that were last remembered, without their trends: they may have led astray."""
        self._launch(contact.take_back_contacts, (rows,), [self._remembered, self.lists, self.stale])

    def extrapolate(self, rows: RowList, step_length: float) -> None:
        """Let the forces go on as in the step before: a first guess."""
        self._launch(contact.extrapolate_forces, (rows, self.capacity), [step_length, self.lists])

    def find_trends(self, rows: RowList, step_length: float, iterations: wp.array) -> None:
        """Note what the step since ``remember``, of so many iterations (world,), changed."""
        self._launch(contact.find_trends, (rows,), [step_length, iterations, self._remembered, self.lists])

    # --- finding points -----------------------------------------------------------------------------------------
    # Where there is too little room for them, nothing is listed, and ``longest`` tells.

    def find(self, rows: RowList, shared: SharedCompliance) -> None:
        """List the candidates at the present displacement; a point found again keeps its force."""
        self._search(rows, self._candidates)
        self._launch(selection.carry_forces, (rows,), [self._candidates, self.lists, self._found, self.stale])
        self._copy(rows, self._found, self.lists)
        self._estimate_rho(rows, shared)

    def complete(self, rows: RowList, shared: SharedCompliance) -> None:
        """Add points that are deep inside a body and not listed; ``missing`` tells how many there were."""
        self._search(rows, self._overlooked)
        inputs = [self.lists, self._found, self._gap, self.missing, self.longest]
        self._launch(selection.count_missing, (rows,), inputs)
        inputs = [self.missing, self.longest, self._found, self.lists, self._merged, self.stale]
        self._launch(contact.merge_contacts, (rows,), inputs)
        self._estimate_rho(rows, shared)

    def _search(self, rows: RowList, scene: detection.Scene) -> None:
        """Fill the list of found points, as far as there is room."""
        bodies, proposed = (rows, faces.BODY_COUNT), [self._proposed, self._proposed_gap]
        self._screen(rows, scene)
        self._launch(detection.propose_contacts, bodies, [scene, self._near, *proposed, self.longest])
        self._launch(selection.drop_dependent, bodies, [scene, *proposed, self._owned])
        self._launch(selection.join_bodies, (rows,), [*proposed, self._found, self._gap, self.longest])

    def pad_gaps(self, rows: RowList, reach: float) -> np.ndarray:
        """Return how far each pad can close before it touches the surface in front of it [m], shape ``(row, 2)``.

        It is inf where there is none within ``reach`` [m].
        """
        scene = self._scene(reach)
        scene.displacement, scene.deep = self._state.start_displacement, np.inf
        self._screen(rows, scene)
        capacity, row_count = 0, faces.BODY_COUNT * rows.count
        while True:
            every = self._contact_list(row_count, capacity)
            gap = wp.zeros((row_count, capacity), dtype=wp.float64, device=self._device)
            longest = wp.zeros(1, dtype=int, device=self._device)
            inputs = [scene, self._near, every, gap, longest]
            self._launch(detection.propose_contacts, (rows, faces.BODY_COUNT), inputs)
            needed = int(longest.numpy()[0])
            if needed <= capacity:
                break
            capacity = needed
        listed = (np.arange(capacity) < every.count.numpy()[:, None]) & (every.key.numpy() >= 0)
        smallest = np.where(listed, gap.numpy(), np.inf).min(axis=1, initial=np.inf)
        return smallest.reshape(-1, faces.BODY_COUNT)[:, [faces.LEFT_PAD, faces.RIGHT_PAD]]

    def _scene(self, margin: float) -> detection.Scene:
        scene, model, state = detection.Scene(), self._model, self._state
        scene.surface, scene.faces, scene.bodies = model.surface, model.faces, state.bodies
        scene.rest, scene.displacement, scene.start_displacement = (
            model.vertices,
            state.displacement,
            state.start_displacement,
        )
        scene.margin, scene.tie, scene.deep = margin, TIE * model.size, DEEP * model.size
        scene.normal, scene.places, scene.listed = self._normal, self._places, self.lists
        return scene

    def _screen(self, rows: RowList, scene: detection.Scene) -> None:
        """Mark the features of the surface that can be nearer to a body than the margin."""
        self._launch(detection.look_at_nodes, (rows, len(self._model.surface.nodes)), [scene])
        self._launch(detection.screen_features, (rows, self._near.shape[2]), [scene, self._near])

    # --- compliance ---------------------------------------------------------------------------------------------

    def refresh_compliance(self, rows: RowList, shared: SharedCompliance) -> None:
        """Assemble W anew where the points, the rotations or the step length changed."""
        stale, state = self._stale_rows, self._state
        stale.select(rows, self.stale, 1, self.longest, self.capacity)
        inputs = [shared.matrix, shared.step_length, self.lists, state.rotation, state.finger_damping]
        outputs = [self._problems.matrix, self.stale, self._assembled_step]
        self._launch(contact.assemble_contact_compliance, (stale, self.capacity), [*inputs, *outputs])
        self._solver.forget(stale)

    def _estimate_rho(self, rows: RowList, shared: SharedCompliance) -> None:
        inputs = [self.lists.count, self.lists.nodes, self.lists.weights, shared.elastic, self._rho]
        self._launch(coulomb.estimate_rho, (rows,), inputs)

    # --- forces -------------------------------------------------------------------------------------------------

    def add_forces(self, rows: RowList, nodal_force: wp.array) -> None:
        """Add the contact forces to nodal forces (world, node) [N]."""
        self._launch(contact.add_forces, (rows,), [self.lists, nodal_force])

    def find_residual(self, rows: RowList) -> None:
        """Find how far each world's worst contact is from its law."""
        self._look_at_contacts(rows, self._no_correction)
        inputs = [self.lists.count, self._model.friction, self._rho, self._force, self._motion, self.residual]
        self._launch(coulomb.contact_residual, (rows,), inputs)

    def solve(self, rows: RowList, correction: wp.array, tolerance: wp.array) -> None:
        """Find the forces that obey the contact laws at displacement + correction.

        Args:
            rows: Worlds.
            correction: Nodal correction that would follow without a change of forces (world, node) [m].
            tolerance: Largest residual (world,) [N].
        """
        self._look_at_contacts(rows, correction)
        self._list_problems_of(rows)
        self._solver.solve(rows, self._problems, tolerance)

    def _list_problems_of(self, rows: RowList) -> None:
        """Let the problems be those of these worlds, in a new struct: the old one belongs to recorded launches."""
        if self._problems.worlds is rows.device.worlds:
            return
        problems = coulomb.ContactProblems()
        for name in coulomb.ContactProblems.vars:
            setattr(problems, name, getattr(self._problems, name))
        problems.worlds = rows.device.worlds
        self._problems = problems

    def take_forces(self, rows: RowList, nodal_force: wp.array, hard: wp.array) -> None:
        """Take the forces of ``solve``.

        Args:
            rows: Worlds.
            nodal_force: What they change is added to it (world, node) [N].
            hard: Counts the problems that needed more than their first method (world,).
        """
        inputs = [self._solver.force, self._solver.attempts, self.lists, nodal_force, hard]
        self._launch(contact.take_forces, (rows,), inputs)

    def _look_at_contacts(self, rows: RowList, correction: wp.array) -> None:
        """Take the contacts' motion at displacement + correction, and their forces, into the work buffers."""
        state = self._state
        inputs = [self._model.vertices, state.bodies, self.lists, state.start_displacement, state.displacement]
        self._launch(contact.contact_state, (rows, self.capacity), [*inputs, correction, self._motion, self._force])

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
