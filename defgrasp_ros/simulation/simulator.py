"""Many worlds of one deformable object between two pads over a platform, stepped together.

One step of length h from (u_n, v_n, q_n) finds displacement u, opening q and contact forces lambda with

    M (u - u_n - h v_n) / h^2 = M g + f_elastic(u) + J^T lambda,      c (q - q_n) / h = sum lambda_n(pads) - F,

under the exact laws of contact (``kernels_coulomb``). Each iteration corrects with the shared inverse P of the rest
state, turned by the nodal rotations R:

    y = R P R^T residual;    solve the contact laws for lambda' with  w = w(u + y) + W (lambda' - lambda);
    u <- u + y + R P R^T J^T (lambda' - lambda).

Its fixed point satisfies the equations above whatever P is. A step counts as solved when both residuals, that of
the nodes and that of the contacts, are below ``TOLERANCE`` of the world's force scale.

All vectors are in the object frame. Gravity and the rigid bodies are set per world, so the hand stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from defgrasp_ros.evaluation import FINGER_NAMES, FingerContact
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import STANDARD_GRAVITY, ObjectModel
from defgrasp_ros.simulation import kernels_contact as contact
from defgrasp_ros.simulation import kernels_coulomb as coulomb
from defgrasp_ros.simulation import kernels_elasticity as elastic
from defgrasp_ros.simulation.coulomb import ContactProblem, CoulombSolver
from defgrasp_ros.simulation.dense import algebra_for
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.simulation.types import mat33d, mat43d, vec2d, vec3d

wp.set_module_options({"enable_backward": False})

TOLERANCE = 1e-6
"""Largest residual of a solved step, relative to the force scale [-]."""
CONTACT_TOLERANCE = 2e-7
"""The same for the contact problem inside an iteration [-]."""
CONTACT_REDUCTION = 1e-3
"""Early iterations need no better contact forces than this fraction of their residual [-]."""
MAX_ITERATIONS = 40
"""Iterations after which a step is given up and cut."""
STEP_CUT = 4
"""Number of smaller steps that replace one that did not converge."""
MAX_CUTS = 2
"""How often a step may be cut before its world is given up."""
ROTATION_TOLERANCE = 0.03
"""Nodal turn [rad] that a soft body's contact compliance tolerates; less by its stiffness ratio (see ``step``)."""
MARGIN = 2e-3
"""Gap below which a point becomes a contact candidate, relative to the mean surface edge [-]."""
PENETRATION = 1e-5
"""Depth of an unlisted point that makes a step look for contacts again, relative to the object's size [-]."""
MAX_SEARCHES = 5
"""How often a step looks for contacts again."""


@dataclass
class StepReport:
    """How a step went, one entry per world that was stepped."""

    converged: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    """Relative to the force scale [-]."""
    cuts: np.ndarray
    contact_fallbacks: np.ndarray


class Simulator:
    """State and time stepping of ``world_count`` copies of an object.

    Args:
        model: The object and its material.
        gripper: The pads.
        world_count: Number of worlds.
        device: Warp device, e.g. ``"cpu"`` or ``"cuda:0"``.
    """

    def __init__(self, model: ObjectModel, gripper: Gripper, world_count: int, device: str = "cpu"):
        wp.init()
        self.model = model
        self.gripper = gripper
        self.world_count = world_count
        self.device = wp.get_device(device)
        self._algebra = algebra_for(self.device)
        self._rest = RestSystem(model)
        self._compliances: dict[float, _DeviceCompliance] = {}
        self._upload_model()
        self._allocate_state()
        self._allocate_contacts(capacity=32)

    # --- set-up -------------------------------------------------------------------------------------------------

    def _upload_model(self) -> None:
        mesh, device = self.model.mesh, self.device
        surface_edge = np.linalg.norm(np.diff(mesh.vertices[mesh.surface_edges], axis=1), axis=-1).mean()
        node_count = len(mesh.vertices)

        self._tetrahedra = wp.array(mesh.tetrahedra, dtype=int, device=device)
        self._gradients = wp.array(mesh.shape_gradients, dtype=mat43d, device=device)
        self._volumes = wp.array(mesh.volumes, dtype=wp.float64, device=device)
        self._lame = vec2d(*self.model.material.lame_parameters)
        self._mass = wp.array(self._rest.mass, dtype=wp.float64, device=device)
        self._vertices = wp.array(mesh.vertices, dtype=vec3d, device=device)
        start, element, corner = _incidence(mesh.tetrahedra, node_count)
        self._incidence = tuple(wp.array(a, dtype=int, device=device) for a in (start, element, corner))

        self._surface = contact.Surface()
        self._surface.nodes = wp.array(mesh.surface_nodes, dtype=int, device=device)
        self._surface.triangles = wp.array(mesh.surface_triangles, dtype=int, device=device)
        self._surface.edges = wp.array(mesh.surface_edges, dtype=int, device=device)
        start, triangle, _ = _incidence(mesh.surface_triangles, node_count)
        self._surface.incidence_start = wp.array(start, dtype=int, device=device)
        self._surface.incidence_triangle = wp.array(triangle, dtype=int, device=device)
        self._surface.edge_key = node_count
        self._surface.corner_key = node_count + 4 * len(mesh.surface_edges)
        self._surface.body_key = self._surface.corner_key + 4 * len(mesh.surface_triangles)

        self._outline = contact.Outline()
        self._outline.half_width = self.gripper.pad_half_width
        self._outline.bottom = self.gripper.pad_bottom
        self._outline.top = self.gripper.pad_top
        self._outline.depth = 0.5 * self.gripper.finger_thickness
        self._outline.snap = 0.1 * surface_edge
        self._margin = MARGIN * surface_edge
        self._penetration = PENETRATION * mesh.size

    def _allocate_state(self) -> None:
        worlds, nodes, tets = self.world_count, len(self.model.mesh.vertices), len(self.model.mesh.tetrahedra)

        def zeros(shape, dtype):
            return wp.zeros(shape, dtype=dtype, device=self.device)

        self._displacement = zeros((worlds, nodes), vec3d)
        self._start_displacement = zeros((worlds, nodes), vec3d)
        self._start_velocity = zeros((worlds, nodes), vec3d)
        self._rotation = zeros((worlds, nodes), mat33d)
        self._rotation.fill_(mat33d(np.eye(3)))
        self._stale = wp.ones(worlds, dtype=int, device=self.device)
        self._assembled_step = np.zeros(worlds)

        self._gravity = zeros(worlds, vec3d)
        self._gravity.fill_(vec3d(0.0, 0.0, -STANDARD_GRAVITY))
        self._finger_damping = wp.ones(worlds, dtype=wp.float64, device=self.device)
        self._closing_force = zeros(worlds, wp.float64)
        self._start_opening = zeros(worlds, wp.float64)
        self.force_scale = np.full(worlds, self.model.weight)
        """Force to which residuals are compared [N], shape ``(world,)``."""

        self._bodies = contact.Bodies()
        self._bodies.enabled = zeros((worlds, contact.BODY_COUNT), int)
        self._bodies.frame = zeros((worlds, contact.BODY_COUNT), mat33d)
        self._bodies.base = zeros((worlds, contact.BODY_COUNT), wp.float64)
        self._bodies.origin = zeros(worlds, vec3d)
        self._bodies.opening = zeros(worlds, wp.float64)
        frame = np.tile(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), (worlds, contact.BODY_COUNT, 1, 1))
        self._bodies.frame.assign(frame)

        self._element_rotation = zeros((worlds, tets), mat33d)
        self._element_force = zeros((worlds, tets), mat43d)
        self._node_rotation = zeros((worlds, nodes), mat33d)
        self._normal = zeros((worlds, nodes), vec3d)
        self._residual = zeros((worlds, nodes), vec3d)
        self._correction = zeros((worlds, nodes), vec3d)
        self._turned = zeros((worlds, nodes), vec3d)
        self._product = zeros((worlds, nodes), vec3d)
        self._norm = zeros(worlds, wp.float64)

    def _allocate_contacts(self, capacity: int) -> None:
        worlds = self.world_count
        old = getattr(self, "_contacts", None)
        self._capacity = capacity
        self._contacts, self._found = self._contact_list(capacity), self._contact_list(capacity)
        if old is not None:
            every = wp.array(np.arange(worlds), dtype=int, device=self.device)
            wp.launch(contact.copy_contacts, dim=worlds, inputs=[every, old, self._contacts], device=self.device)
        self._gap = wp.zeros((worlds, capacity), dtype=wp.float64, device=self.device)
        self._missing = wp.zeros(worlds, dtype=int, device=self.device)
        self._force = wp.zeros((worlds, capacity), dtype=vec3d, device=self.device)
        self._motion = wp.zeros((worlds, capacity), dtype=vec3d, device=self.device)
        self._contact_residual = wp.zeros(worlds, dtype=wp.float64, device=self.device)
        self._rho = wp.zeros(worlds, dtype=wp.float64, device=self.device)
        square = (worlds, 3 * capacity, 3 * capacity)
        self._contact_compliance = wp.zeros(square, dtype=wp.float64, device=self.device)
        self._contact_inverse = wp.zeros(square, dtype=wp.float64, device=self.device)
        self._solver = CoulombSolver(worlds, capacity, self.device, self._algebra)
        self._stale.fill_(1)

    def _contact_list(self, capacity: int) -> contact.ContactList:
        result = contact.ContactList()
        result.count = wp.zeros(self.world_count, dtype=int, device=self.device)
        for name, dtype in (("key", int), ("body", int), ("nodes", wp.vec3i), ("weights", vec3d), ("force", vec3d)):
            setattr(result, name, wp.zeros((self.world_count, capacity), dtype=dtype, device=self.device))
        return result

    # --- what the worlds contain --------------------------------------------------------------------------------

    def place_platform(self, worlds: np.ndarray, height: float) -> None:
        """Put the platform's surface at z = ``height`` [m] in some worlds."""
        self._set(self._bodies.enabled, (worlds, contact.PLATFORM), 1)
        self._set(self._bodies.base, (worlds, contact.PLATFORM), height)

    def place_gripper(self, worlds: np.ndarray, grasps: list[Grasp], opening: np.ndarray, full_force: np.ndarray) -> None:
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
        for pad, normal in ((contact.LEFT_PAD, -y), (contact.RIGHT_PAD, y)):
            self._set(self._bodies.enabled, (worlds, pad), 1)
            self._set(self._bodies.frame, (worlds, pad), np.stack([normal, x, z], axis=1))
            self._set(self._bodies.base, (worlds, pad), np.einsum("ij,ij->i", normal, origin))
        self._set(self._bodies.origin, worlds, origin)
        self._set(self._bodies.opening, worlds, opening)
        self._set(self._start_opening, worlds, opening)
        self._set(self._finger_damping, worlds, full_force / self.gripper.closing_speed)
        self._set(self._closing_force, worlds, 0.0)
        self.force_scale[worlds] = np.maximum(full_force, self.model.weight)

    def set_gravity(self, worlds: np.ndarray, gravity: np.ndarray) -> None:
        """Set the gravity vector [m/s^2] of some worlds."""
        self._set(self._gravity, worlds, gravity)

    def copy_world(self, source: int, worlds: np.ndarray) -> None:
        """Give some worlds the displacement, velocity and contacts of another."""
        for array in (self._displacement, self._start_displacement, self._start_velocity, self._rotation):
            self._set(array, worlds, array.numpy()[source])
        for name in ("count", "key", "body", "nodes", "weights", "force"):
            array = getattr(self._contacts, name)
            self._set(array, worlds, array.numpy()[source])
        self._set(self._stale, worlds, 1)

    @staticmethod
    def _set(array: wp.array, index, value) -> None:
        values = array.numpy()
        values[index] = value
        if array.device.is_cuda:
            array.assign(values)

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
        start_force = self._closing_force.numpy()[worlds].copy()
        start_height = self._bodies.base.numpy()[worlds, contact.PLATFORM].copy()
        report = self._try_step(worlds, step_length, closing_force, platform_height, quasi_static)
        for cut in range(1, MAX_CUTS + 1):
            failed = np.flatnonzero(~report.converged)
            if not len(failed):
                break
            pieces = STEP_CUT**cut
            report.cuts[failed] = cut
            report.converged[failed] = True
            backup = self._backup(worlds[failed])
            for piece in range(1, pieces + 1):
                good = failed[report.converged[failed]]
                if not len(good):
                    break
                force = start_force[good] + (closing_force[good] - start_force[good]) * piece / pieces
                height = start_height[good] + (platform_height[good] - start_height[good]) * piece / pieces
                part = self._try_step(worlds[good], step_length / pieces, force, height, quasi_static)
                report.converged[good] = part.converged
                report.iterations[good] += part.iterations
                report.contact_fallbacks[good] += part.contact_fallbacks
                report.residual[good] = part.residual if piece == 1 else np.maximum(report.residual[good], part.residual)
            self._restore(backup, worlds[failed], ~report.converged[failed])
        bad = ~report.converged
        self._set(self._closing_force, worlds[bad], start_force[bad])
        self._set(self._bodies.base, (worlds[bad], contact.PLATFORM), start_height[bad])
        return report

    def _backup(self, worlds: np.ndarray) -> list[np.ndarray]:
        return [array.numpy()[worlds].copy() for array in (self._start_displacement, self._start_velocity, self._start_opening)]

    def _restore(self, backup: list[np.ndarray], worlds: np.ndarray, which: np.ndarray) -> None:
        for array, values in zip((self._start_displacement, self._start_velocity, self._start_opening), backup, strict=True):
            self._set(array, worlds[which], values[which])

    def _try_step(
        self, worlds: np.ndarray, h: float, closing_force: np.ndarray, platform_height: np.ndarray, quasi_static: bool
    ) -> StepReport:
        """Solve one step; worlds that do not converge stay where they were."""
        self._set(self._closing_force, worlds, closing_force)
        self._set(self._bodies.base, (worlds, contact.PLATFORM), platform_height)
        compliance = self._compliance(h)
        self._set(self._stale, worlds[self._assembled_step[worlds] != h], 1)

        count = len(worlds)
        report = StepReport(
            converged=np.zeros(count, dtype=bool),
            iterations=np.zeros(count, dtype=int),
            residual=np.full(count, np.inf),
            cuts=np.zeros(count, dtype=int),
            contact_fallbacks=np.zeros(count, dtype=int),
        )
        rows = self._indices(worlds)
        nodes = len(self.model.mesh.vertices)
        self._launch(elastic.predict, (count, nodes), [rows, h, self._start_displacement, self._start_velocity, self._displacement])
        self._move_fingers(rows, h)
        self._find_contacts(rows)
        self._move_fingers(rows, h)

        active = np.arange(count)
        searches = np.zeros(count, dtype=int)
        for iteration in range(MAX_ITERATIONS + 1):
            rows = self._indices(worlds[active])
            scale = self.force_scale[worlds[active]]
            residual = self._evaluate_residual(rows, h, compliance) / scale
            report.residual[active] = residual
            solved = residual < TOLERANCE
            if solved.any():
                incomplete = self._find_contacts(self._indices(worlds[active[solved]]), only_missing=True)
                again = np.zeros(len(active), dtype=bool)
                again[np.flatnonzero(solved)[incomplete]] = True
                searches[active[again]] += 1
                again &= searches[active] <= MAX_SEARCHES
                if again.any():
                    self._find_contacts(self._indices(worlds[active[again]]))
                    self._evaluate_residual(rows, h, compliance)
                solved &= ~again
            report.converged[active[solved]] = True
            if iteration == MAX_ITERATIONS or not (~solved).any() or not np.isfinite(residual).all():
                break
            if solved.any():
                active = active[~solved]
                rows = self._indices(worlds[active])
                scale = self.force_scale[worlds[active]]
                self._evaluate_residual(rows, h, compliance)
            report.iterations[active] += 1
            report.contact_fallbacks[active] += self._correct(rows, h, compliance, scale, report.residual[active])

        good = worlds[report.converged]
        if len(good):
            inputs = [self._indices(good), h, 0.0 if quasi_static else 1.0, self._displacement]
            self._launch(elastic.accept_step, (len(good), nodes), [*inputs, self._start_displacement, self._start_velocity])
            self._set(self._start_opening, good, self._bodies.opening.numpy()[good])
        return report

    def _evaluate_residual(self, rows: wp.array, h: float, compliance: _DeviceCompliance) -> np.ndarray:
        """Leave the nodal residual and the contact state in the work buffers; return the worse of both norms [N]."""
        count, nodes = rows.shape[0], len(self.model.mesh.vertices)
        self._launch(
            elastic.element_forces,
            (count, len(self.model.mesh.tetrahedra)),
            [self._tetrahedra, self._gradients, self._volumes, self._lame, rows, self._displacement],
            [self._element_rotation, self._element_force],
        )
        start, tet, corner = self._incidence
        self._launch(
            elastic.dynamic_residual,
            (count, nodes),
            [start, tet, corner, self._mass, h, rows, self._gravity, self._start_displacement, self._start_velocity]
            + [self._displacement, self._element_force],
            [self._residual],
        )
        self._refresh_rotations(rows, compliance)
        self._refresh_contact_compliance(rows, h, compliance)
        self._launch(contact.gather_forces, (count, self._capacity), [rows, self._contacts], [self._force])
        self._launch(contact.scatter_contact_forces, count, [self._bodies, self._contacts, rows, self._force, self._residual])
        self._correction.zero_()
        self._relative_motion(rows)
        self._launch(
            coulomb.contact_residual,
            count,
            [self._contacts.count, rows, self.model.material.friction_coefficient, self._rho, self._force, self._motion],
            [self._contact_residual],
        )
        self._launch(_row_norms, count, [self._residual], [self._norm])
        return np.maximum(self._norm.numpy()[:count], self._contact_residual.numpy()[:count])

    def _refresh_rotations(self, rows: wp.array, compliance: _DeviceCompliance) -> None:
        """Follow the nodes' rotations; stiff bodies need it sooner, as a turn then looks like a strain."""
        start, tet, _ = self._incidence
        count, nodes = rows.shape[0], len(self.model.mesh.vertices)
        inputs = [start, tet, self._volumes, self._element_rotation]
        self._launch(elastic.nodal_rotations, (count, nodes), inputs, [self._node_rotation])
        inputs = [rows, self._node_rotation, compliance.rotation_tolerance]
        self._launch(elastic.refresh_rotations, count, inputs, [self._rotation, self._stale])

    def _refresh_contact_compliance(self, rows: wp.array, h: float, compliance: _DeviceCompliance) -> None:
        """Assemble and invert W anew where the contact points or the rotations changed."""
        worlds = rows.numpy()
        stale = worlds[self._stale.numpy()[worlds] != 0]
        if not len(stale):
            return
        some = self._indices(stale)
        lists = self._contacts
        inputs = [lists.count, lists.nodes, lists.weights, compliance.elastic, some]
        self._launch(coulomb.estimate_rho, len(stale), inputs, [self._rho])
        self._launch(
            contact.assemble_contact_compliance,
            (len(stale), self._capacity, self._capacity),
            [compliance.matrix, h, self._bodies, lists, some, self._rotation, self._finger_damping],
            [self._contact_compliance],
        )
        sizes = 3 * lists.count.numpy()
        self._algebra.invert(self._contact_compliance, stale, sizes, self._rho.numpy(), self._contact_inverse)
        self._set(self._stale, stale, 0)
        self._assembled_step[stale] = h

    def _correct(
        self, rows: wp.array, h: float, compliance: _DeviceCompliance, scale: np.ndarray, residual: np.ndarray
    ) -> np.ndarray:
        """One quasi-Newton correction of displacement, opening and forces; return fallbacks per row."""
        count, nodes = rows.shape[0], len(self.model.mesh.vertices)
        self._apply_compliance(rows, compliance, self._residual)
        self._relative_motion(rows)
        tolerance = scale * np.maximum(CONTACT_TOLERANCE, CONTACT_REDUCTION * residual)
        problem = ContactProblem(
            worlds=rows,
            count=self._contacts.count,
            friction=self.model.material.friction_coefficient,
            rho=self._rho,
            matrix=self._contact_compliance,
            inverse=self._contact_inverse,
            force=self._force[:count],
            motion=self._motion[:count],
            tolerance=wp.array(tolerance, dtype=wp.float64, device=self.device),
        )
        force, fallbacks = self._solver.solve(problem)
        self._launch(elastic.add_correction, (count, nodes), [rows, self._correction, self._displacement])
        self._launch(contact.store_forces, (count, self._capacity), [rows, force, self._contacts])
        self._launch(_force_change, (count, self._capacity), [force, self._force])
        self._residual.zero_()
        self._launch(contact.scatter_contact_forces, count, [self._bodies, self._contacts, rows, self._force, self._residual])
        self._apply_compliance(rows, compliance, self._residual)
        self._launch(elastic.add_correction, (count, nodes), [rows, self._correction, self._displacement])
        self._move_fingers(rows, h)
        return fallbacks

    def _apply_compliance(self, rows: wp.array, compliance: _DeviceCompliance, force: wp.array) -> None:
        """correction = R P R^T force."""
        count, nodes = rows.shape[0], len(self.model.mesh.vertices)
        self._launch(elastic.rotate_back, (count, nodes), [rows, self._rotation, force], [self._turned])
        flat = [
            wp.array(ptr=a.ptr, dtype=wp.float64, shape=(count, 3 * nodes), device=self.device)
            for a in (self._turned, self._product)
        ]
        self._algebra.multiply_rows(flat[0], compliance.matrix, flat[1])
        self._launch(elastic.rotate, (count, nodes), [rows, self._rotation, self._product], [self._correction])

    def _relative_motion(self, rows: wp.array) -> None:
        inputs = [self._vertices, self._bodies, self._contacts, rows, self._start_displacement, self._displacement]
        self._launch(contact.relative_motion, (rows.shape[0], self._capacity), [*inputs, self._correction], [self._motion])

    def _move_fingers(self, rows: wp.array, h: float) -> None:
        inputs = [self._contacts, rows, h, self._finger_damping, self._closing_force, self._start_opening]
        self._launch(contact.move_fingers, rows.shape[0], inputs, [self._bodies.opening])

    def _find_contacts(self, rows: wp.array, *, only_missing: bool = False) -> np.ndarray:
        """List the contact candidates at the present displacement; return which rows had unlisted deep points.

        With ``only_missing`` the lists stay as they are.
        """
        worlds = rows.numpy()
        count = len(worlds)
        inputs = [self._surface, self._vertices, rows, self._displacement]
        self._launch(contact.surface_normals, (count, len(self.model.mesh.surface_nodes)), inputs, [self._normal])
        margin = -self._penetration if only_missing else self._margin
        while True:
            inputs = [self._surface, self._outline, self._vertices, margin, self._bodies, rows, self._displacement, self._normal]
            self._launch(contact.find_contacts, count, inputs, [self._found, self._gap])
            largest = int(self._found.count.numpy()[worlds].max(initial=0))
            if largest <= self._capacity:
                break
            self._allocate_contacts(capacity=32 * -(-largest // 32))
        stale = wp.clone(self._stale) if only_missing else self._stale
        inputs = [rows, self._contacts, self._gap, self._penetration]
        self._launch(contact.carry_forces, count, inputs, [self._found, stale, self._missing])
        if not only_missing:
            self._launch(contact.copy_contacts, count, [rows, self._found, self._contacts])
        return self._missing.numpy()[:count] > 0

    def _compliance(self, h: float) -> _DeviceCompliance:
        if h not in self._compliances:
            host = self._rest.compliance(h)
            self._compliances[h] = _DeviceCompliance(
                matrix=wp.array(host.matrix, dtype=wp.float64, device=self.device, copy=False),
                elastic=wp.array(host.elastic, dtype=wp.float64, device=self.device),
                rotation_tolerance=ROTATION_TOLERANCE / (1.0 + host.rigid / float(np.median(host.elastic))),
            )
        return self._compliances[h]

    def _indices(self, worlds: np.ndarray) -> wp.array:
        return wp.array(worlds, dtype=int, device=self.device)

    def _launch(self, kernel, dim, inputs: list, outputs: list | None = None) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs or [], device=self.device)

    # --- what can be seen ---------------------------------------------------------------------------------------

    def positions(self, worlds: np.ndarray) -> np.ndarray:
        """Nodes [m], shape ``(n, node, 3)``."""
        return self.model.mesh.vertices + self._start_displacement.numpy()[worlds]

    def velocities(self, worlds: np.ndarray) -> np.ndarray:
        """Nodal velocities [m/s], shape ``(n, node, 3)``; zero after a quasi-static step."""
        return self._start_velocity.numpy()[worlds]

    def openings(self, worlds: np.ndarray) -> np.ndarray:
        """Distance of each pad face from the grasp frame's origin [m], shape ``(n,)``."""
        return self._start_opening.numpy()[worlds]

    def opening_velocities(self, worlds: np.ndarray) -> np.ndarray:
        """Rate of the opening that the finger law gives for the present forces [m/s], shape ``(n,)``."""
        pads = self.normal_forces(worlds)[:, : contact.PLATFORM].sum(axis=1)
        return (pads - self._closing_force.numpy()[worlds]) / self._finger_damping.numpy()[worlds]

    def stresses(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stress tensors in the elements' frames [Pa], ``(n, tet, 3, 3)``, and strain energies [J], ``(n, tet)``."""
        count, tets = len(worlds), len(self.model.mesh.tetrahedra)
        stress = wp.zeros((count, tets), dtype=mat33d, device=self.device)
        density = wp.zeros((count, tets), dtype=wp.float64, device=self.device)
        inputs = [self._tetrahedra, self._gradients, self._lame, self._indices(worlds), self._start_displacement]
        self._launch(elastic.element_stress, (count, tets), inputs, [stress, density])
        return stress.numpy(), density.numpy() * self.model.mesh.volumes

    def normal_forces(self, worlds: np.ndarray) -> np.ndarray:
        """Sum of the normal forces of left pad, right pad and platform [N], shape ``(n, 3)``."""
        lists = self._contacts
        count, body, force = lists.count.numpy()[worlds], lists.body.numpy()[worlds], lists.force.numpy()[worlds, :, 0]
        listed = np.arange(self._capacity) < count[:, None]
        return np.stack([np.where(listed & (body == b), force, 0.0).sum(axis=1) for b in range(contact.BODY_COUNT)], axis=1)

    def pad_gaps(self, worlds: np.ndarray) -> np.ndarray:
        """Distance of each pad face from the surface in front of it [m], shape ``(n, 2)``; inf where there is none."""
        rows = self._indices(worlds)
        inputs = [self._surface, self._vertices, rows, self._start_displacement]
        self._launch(contact.surface_normals, (len(worlds), len(self.model.mesh.surface_nodes)), inputs, [self._normal])
        reach = 2.0 * self.gripper.max_opening
        inputs = [self._surface, self._outline, self._vertices, reach, self._bodies, rows, self._start_displacement, self._normal]
        everything = self._contact_list(capacity=self._surface.body_key)
        gap = wp.zeros((self.world_count, self._surface.body_key), dtype=wp.float64, device=self.device)
        self._launch(contact.find_contacts, len(worlds), inputs, [everything, gap])
        count, body = everything.count.numpy()[worlds], everything.body.numpy()[worlds]
        listed = np.arange(body.shape[1]) < count[:, None]
        gaps = gap.numpy()[worlds]
        pads = (contact.LEFT_PAD, contact.RIGHT_PAD)
        return np.stack([np.where(listed & (body == pad), gaps, np.inf).min(axis=1) for pad in pads], axis=1)

    def contact_forces(self, worlds: np.ndarray) -> list[ContactForces]:
        """The contact points that carry force, per world."""
        lists, bodies = self._contacts, self._bodies
        count, body = lists.count.numpy(), lists.body.numpy()
        nodes, weights, force = lists.nodes.numpy(), lists.weights.numpy(), lists.force.numpy()
        frames = bodies.frame.numpy()
        positions = self.positions(worlds)
        result = []
        for row, w in enumerate(worlds):
            loaded = np.flatnonzero(force[w, : count[w], 0] > 0.0)
            frame = frames[w][body[w, loaded]]
            points = np.einsum("ck,ckj->cj", weights[w, loaded], positions[row][nodes[w, loaded]])
            result.append(
                ContactForces(
                    body=body[w, loaded],
                    positions=points,
                    normals=frame[:, 0],
                    forces=np.einsum("cij,ci->cj", frame, force[w, loaded]),
                    nodes=nodes[w, loaded],
                    weights=weights[w, loaded],
                    friction=self.model.material.friction_coefficient,
                )
            )
        return result


@dataclass
class ContactForces:
    """Loaded contact points of one world; vectors in the object frame, shape ``(contact, 3)``."""

    body: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    forces: np.ndarray
    """On the object [N]."""
    nodes: np.ndarray
    weights: np.ndarray
    friction: float

    def normal_force(self, body: int) -> float:
        """Sum of the normal forces of one body [N]."""
        mine = self.body == body
        return float(np.einsum("ij,ij->", self.forces[mine], self.normals[mine]))

    def fingers(self) -> tuple[FingerContact, FingerContact]:
        """What the left and the right finger feel."""
        return tuple(self._finger(pad, name) for pad, name in zip((contact.LEFT_PAD, contact.RIGHT_PAD), FINGER_NAMES, strict=True))

    def _finger(self, pad: int, name: str) -> FingerContact:
        mine = self.body == pad
        finger = FingerContact(name, self.positions[mine], self.normals[mine], self.forces[mine])
        friction_force = self.forces[mine] - finger.normal_forces[:, None] * self.normals[mine]
        limit = self.friction * finger.normal_forces
        at_limit = np.linalg.norm(friction_force, axis=1) > 0.999 * limit
        finger.slipping = bool(finger.count and at_limit.all())
        return finger


@dataclass(frozen=True, eq=False)
class _DeviceCompliance:
    matrix: wp.array
    elastic: wp.array
    rotation_tolerance: float


def _incidence(cells: np.ndarray, node_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells around each node: start of each node's range ``(node + 1,)``, then cell and corner ``(incidence,)``."""
    order = np.argsort(cells.ravel(), kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(cells.ravel(), minlength=node_count))])
    return start, order // cells.shape[1], order % cells.shape[1]


@wp.kernel
def _row_norms(vector: wp.array2d[vec3d], norm_out: wp.array[wp.float64]):
    """Euclidean norm of each row."""
    i = wp.tid()
    total = wp.float64(0.0)
    for n in range(vector.shape[1]):
        total += wp.dot(vector[i, n], vector[i, n])
    norm_out[i] = wp.sqrt(total)


@wp.kernel
def _force_change(force: wp.array2d[vec3d], change: wp.array2d[vec3d]):
    """change = force - change."""
    i, c = wp.tid()
    change[i, c] = force[i, c] - change[i, c]
