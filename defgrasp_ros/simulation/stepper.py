"""One implicit time step of some worlds: the quasi-Newton iteration with exact contact.

One step of length h from (u_n, v_n, q_n) finds displacement u, opening q and contact forces lambda with

    M (u - u_n - h v_n) / h^2 = M g + f_elastic(u) + J^T lambda,      c (q - q_n) / h = sum lambda_n(pads) - F,

under the exact laws of contact (``kernels_coulomb``). Each iteration corrects with the shared inverse P of the rest
state, turned by the nodal rotations R:

    y = R P R^T residual;    solve the contact laws for lambda' with  w = w(u + y) + W (lambda' - lambda);
    u <- u + y + R P R^T J^T (lambda' - lambda).

Anderson acceleration mixes it with the iterates before (:mod:`anderson`). The fixed point satisfies the equations above
whatever P is. A step counts as solved when both residuals, that of
the nodes and that of the contacts, are below ``TOLERANCE`` of the world's force scale.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import warp as wp

from defgrasp_ros.simulation import kernels_contact as contact
from defgrasp_ros.simulation import kernels_elasticity as elastic
from defgrasp_ros.simulation.anderson import DEPTH, Anderson
from defgrasp_ros.simulation.contact_set import ContactSet
from defgrasp_ros.simulation.dense import multiply_rows
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.shared_compliance import SharedCompliance
from defgrasp_ros.simulation.types import mat33d, vec3d
from defgrasp_ros.simulation.world_state import WorldState, clear_rows, set_entries

wp.set_module_options({"enable_backward": False})

TOLERANCE = 1e-6
"""Largest residual of a solved step, relative to the force scale [-]."""
CONTACT_TOLERANCE = 2e-7
"""The same for the contact problem inside an iteration [-]."""
CONTACT_REDUCTION = 1e-3
"""Early iterations need no better contact forces than this fraction of their residual [-]."""
MAX_ITERATIONS = 40
"""Iterations after which a step is given up; all counts begin anew where overlooked contacts were found."""
MAX_STALLED = 8
"""Iterations in a row that do not reduce the residual after which a step is given up."""
RESTART_GROWTH = 2.0
"""Growth of the residual in an iteration at which the acceleration starts anew [-], unless it has just begun: where the
plain iteration diverges, it must be let go on until it knows the modes that grow."""
MAX_INVERTED_SHARE = 1e-3
"""Part of a body's volume that may be turned inside out [-]: a sliver or two of the mesh hold next to nothing."""
MAX_SEARCHES = 5
"""How often a solved step may find contacts that it overlooked before it counts as failed."""


@dataclass
class StepReport:
    """How a step went, one entry per world that was stepped."""

    converged: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    """Relative to the force scale [-]."""
    cuts: np.ndarray
    """How often the step was divided."""
    contact_fallbacks: np.ndarray
    """Contact problems that needed more than their first method."""
    crushed: np.ndarray
    """Whether elements have turned inside out, so that the solution has no meaning."""

    @property
    def usable(self) -> np.ndarray:
        """Whether there is a solution, and it has a meaning."""
        return self.converged & ~self.crushed

    @classmethod
    def empty(cls, count: int) -> StepReport:
        """A report of a step that has not begun."""
        return cls(
            converged=np.zeros(count, dtype=bool),
            iterations=np.zeros(count, dtype=int),
            residual=np.full(count, np.inf),
            cuts=np.zeros(count, dtype=int),
            contact_fallbacks=np.zeros(count, dtype=int),
            crushed=np.zeros(count, dtype=bool),
        )

    def put(self, places: np.ndarray, part: StepReport) -> None:
        """Take over the report of some of the worlds."""
        for field in fields(self):
            getattr(self, field.name)[places] = getattr(part, field.name)


class Stepper:
    """Work buffers and the iteration."""

    def __init__(
        self,
        model: DeviceModel,
        state: WorldState,
        contacts: ContactSet,
        world_count: int,
        device: wp.Device,
    ):
        self._model = model
        self._state = state
        self._contacts = contacts
        self._device = device

        def zeros(columns: int, dtype) -> wp.array:
            return wp.zeros((world_count, columns), dtype=dtype, device=device)

        self._element_rotation = zeros(model.tet_count, mat33d)
        self._element_force = zeros(model.entry_count, vec3d)
        self._node_rotation = zeros(model.node_count, mat33d)
        self._start_rotation = zeros(model.node_count, mat33d)
        self._residual, self._correction, self._turned, self._product = (
            zeros(model.node_count, vec3d) for _ in range(4)
        )
        self._before = zeros(model.node_count, vec3d)
        self._anderson = Anderson(world_count, model.node_count, contacts.capacity, device)
        self._norm = wp.zeros(world_count, dtype=wp.float64, device=device)

    def step(
        self, worlds: np.ndarray, shared: SharedCompliance, force_scale: np.ndarray, *, quasi_static: bool
    ) -> StepReport:
        """Solve one step; worlds that do not converge stay where they were.

        Args:
            worlds: Indices, shape ``(n,)``.
            shared: The inverse for the step's length.
            force_scale: Force to which residuals are compared [N], shape ``(n,)``.
            quasi_static: Whether the velocity is forgotten after the step.
        """
        state, contacts, h = self._state, self._contacts, shared.step_length
        count = len(worlds)
        report = StepReport.empty(count)
        contacts.expect_step(worlds, h)
        rows = self._rows(worlds)
        contacts.remember(rows)
        wp.copy(self._start_rotation, state.rotation)
        self._predict(rows, state.start_velocity, h)
        contacts.find(rows)
        contacts.extrapolate(rows, h)
        self._predict(rows, state.trend, h)

        self._forget(worlds)
        active = np.arange(count)
        last_residual, best_residual = np.full(count, np.inf), np.full(count, np.inf)
        stalled, spent, searches, accelerated = (np.zeros(count, dtype=int) for _ in range(4))
        while len(active):
            rows = self._rows(worlds[active])
            residual = self._evaluate_residual(rows, shared) / force_scale[active]
            report.residual[active] = residual
            stalled[active] = np.where(residual < best_residual[active], 0, stalled[active] + 1)
            best_residual[active] = np.fmin(best_residual[active], residual)
            goes_on = np.isfinite(residual) & (stalled[active] <= MAX_STALLED) & (spent[active] < MAX_ITERATIONS)
            solved = residual < TOLERANCE
            if solved.any():
                incomplete = self._overlooked_contacts(worlds, active, solved, searches)
                report.converged[active[solved & ~incomplete]] = True
                again = active[incomplete]
                spent[again], stalled[again], best_residual[again] = 0, 0, np.inf
                goes_on = np.where(solved, incomplete & (searches[active] <= MAX_SEARCHES), goes_on)
            active = active[goes_on]
            if not len(active):
                break
            if solved.any() or not goes_on.all():
                rows = self._rows(worlds[active])
                self._evaluate_residual(rows, shared)
            grows = report.residual[active] > RESTART_GROWTH * last_residual[active]
            restarts = active[grows & (accelerated[active] >= int(DEPTH))]
            self._forget(worlds[restarts])
            accelerated[restarts] = 0
            accelerated[active] += 1
            last_residual[active] = report.residual[active]
            report.iterations[active] += 1
            spent[active] += 1
            reduction = np.maximum(CONTACT_TOLERANCE, CONTACT_REDUCTION * report.residual[active])
            report.contact_fallbacks[active] += self._correct(rows, shared, force_scale[active] * reduction)

        self._accept(worlds[report.converged], h, quasi_static)
        report.crushed = self._are_crushed(worlds)
        self._stand_still(worlds[report.converged & (report.iterations == 0)])
        self._go_back(worlds[~report.converged])
        return report

    def _predict(self, rows: wp.array, velocity: wp.array, h: float) -> None:
        """Put the nodes where a velocity takes them, and the fingers where the contact forces do."""
        inputs = [rows, h, self._state.start_displacement, velocity, self._state.displacement]
        self._launch(elastic.predict, (rows.shape[0], self._model.node_count), inputs)
        self._move_fingers(rows, h)

    def _overlooked_contacts(
        self, worlds: np.ndarray, active: np.ndarray, solved: np.ndarray, searches: np.ndarray
    ) -> np.ndarray:
        """List the points that a solved world has inside a body without knowing; return where there are any."""
        candidates = np.flatnonzero(solved)
        incomplete = self._contacts.complete(self._rows(worlds[active[candidates]]))
        again = np.zeros(len(active), dtype=bool)
        again[candidates[incomplete]] = True
        searches[active[again]] += 1
        self._forget(worlds[active[again]])
        return again

    def _forget(self, worlds: np.ndarray) -> None:
        """Start the acceleration of some worlds anew."""
        if self._contacts.capacity != self._anderson.capacity:
            world_count = self._norm.shape[0]
            self._anderson = Anderson(world_count, self._model.node_count, self._contacts.capacity, self._device)
        set_entries(self._anderson.length, worlds, 0)

    def _evaluate_residual(self, rows: wp.array, shared: SharedCompliance) -> np.ndarray:
        """Leave the nodal residual in its buffer; return the worse of nodal and contact residual [N]."""
        model, state, count = self._model, self._state, rows.shape[0]
        self._launch(
            model.kernels.forces,
            (count, model.tet_count),
            [model.elements, model.gradients, model.volumes, model.lame, rows, state.displacement],
            [self._element_rotation, self._element_force],
        )
        nodes, acceleration = (count, model.node_count), self._product
        self._launch(
            elastic.missing_acceleration,
            nodes,
            [model.vertices, shared.step_length, rows, state.gravity, state.spin]
            + [state.start_displacement, state.start_velocity, state.displacement],
            [acceleration],
        )
        self._launch(
            elastic.dynamic_residual,
            nodes,
            [model.incidence_start, model.incidence_entry, model.mass_start, model.mass_node, model.mass]
            + [acceleration, self._element_force],
            [self._residual],
        )
        self._refresh_rotations(rows, shared)
        self._contacts.refresh_compliance(rows, shared)
        self._contacts.add_forces(rows, self._residual)
        self._launch(_row_norms, count, [self._residual], [self._norm])
        return np.maximum(self._norm.numpy()[:count], self._contacts.residual(rows))

    def _refresh_rotations(self, rows: wp.array, shared: SharedCompliance) -> None:
        """Follow the nodes' rotations where they have changed too much."""
        model, state, count = self._model, self._state, rows.shape[0]
        inputs = [model.incidence_start, model.incidence_tet, model.volumes, self._element_rotation]
        self._launch(elastic.nodal_rotations, (count, model.node_count), inputs, [self._node_rotation])
        inputs = [rows, self._node_rotation, shared.rotation_tolerance]
        self._launch(elastic.refresh_rotations, count, inputs, [state.rotation, self._contacts.stale])

    def _correct(self, rows: wp.array, shared: SharedCompliance, contact_tolerance: np.ndarray) -> np.ndarray:
        """One correction of displacement, opening and forces; return which rows had a hard contact problem."""
        nodes, displacement = (rows.shape[0], self._model.node_count), self._state.displacement
        lists = self._contacts.lists
        self._launch(_take_rows, nodes, [rows, displacement], [self._before])
        self._apply_compliance(rows, shared)
        hard = self._contacts.solve(rows, self._correction, contact_tolerance)
        self._launch(elastic.add_correction, nodes, [rows, self._correction, displacement])
        self._residual.zero_()
        self._contacts.add_force_change(rows, self._residual)
        self._apply_compliance(rows, shared)
        self._launch(elastic.add_correction, nodes, [rows, self._correction, displacement])
        self._anderson.mix(rows, self._before, displacement, lists.count, lists.force)
        self._move_fingers(rows, shared.step_length)
        return hard

    def _apply_compliance(self, rows: wp.array, shared: SharedCompliance) -> None:
        """correction = R P R^T residual."""
        nodes, rotation = (rows.shape[0], self._model.node_count), self._state.rotation
        self._launch(elastic.rotate_back, nodes, [rows, rotation, self._residual], [self._turned])
        turned, product = (
            wp.array(ptr=a.ptr, dtype=wp.float64, shape=(nodes[0], 3 * nodes[1]), device=self._device)
            for a in (self._turned, self._product)
        )
        multiply_rows(turned, shared.matrix, product)
        self._launch(elastic.rotate, nodes, [rows, rotation, self._product], [self._correction])

    def _move_fingers(self, rows: wp.array, h: float) -> None:
        state = self._state
        inputs = [self._contacts.lists, rows, h, state.finger_damping, state.closing_force, state.start_opening]
        self._launch(contact.move_fingers, rows.shape[0], inputs, [state.bodies.opening])

    def _accept(self, worlds: np.ndarray, h: float, quasi_static: bool) -> None:
        """The end of the step becomes the start of the next."""
        if not len(worlds):
            return
        state = self._state
        rows = self._rows(worlds)
        self._contacts.find_trends(rows, h)
        inputs = [rows, h, 0.0 if quasi_static else 1.0, state.displacement]
        motion = [state.start_displacement, state.start_velocity, state.trend]
        self._launch(elastic.accept_step, (len(worlds), self._model.node_count), [*inputs, *motion])
        set_entries(state.start_opening, worlds, state.bodies.opening.numpy()[worlds])

    def _stand_still(self, worlds: np.ndarray) -> None:
        """Forget the trends of worlds that needed no iteration: nothing else would end a drift below the tolerance."""
        rows = self._rows(worlds)
        clear_rows(self._state.trend, rows)
        self._contacts.forget_trends(rows)

    def _are_crushed(self, worlds: np.ndarray) -> np.ndarray:
        """Return which worlds have more than a few elements turned inside out."""
        model, volume = self._model, wp.empty(len(worlds), dtype=wp.float64, device=self._device)
        inputs = [model.elements, model.gradients, model.volumes, self._rows(worlds), self._state.start_displacement]
        self._launch(model.kernels.inversions, len(worlds), inputs, [volume])
        return volume.numpy() > MAX_INVERTED_SHARE * model.volume

    def _go_back(self, worlds: np.ndarray) -> None:
        """Leave no trace of a step that failed."""
        if not len(worlds):
            return
        state = self._state
        rows = self._rows(worlds)
        self._contacts.go_back(rows)
        clear_rows(state.trend, rows)
        set_entries(state.rotation, worlds, self._start_rotation.numpy()[worlds])
        set_entries(state.bodies.opening, worlds, state.start_opening.numpy()[worlds])

    def _rows(self, worlds: np.ndarray) -> wp.array:
        return wp.array(worlds, dtype=int, device=self._device)

    def _launch(self, kernel, dim, inputs: list, outputs: list | None = None) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs or [], device=self._device)


@wp.kernel
def _take_rows(worlds: wp.array[int], field: wp.array2d[vec3d], rows_out: wp.array2d[vec3d]):
    """Copy a nodal field of some worlds (world, node) into a work buffer (row, node)."""
    i, n = wp.tid()
    rows_out[i, n] = field[worlds[i], n]


@wp.kernel
def _row_norms(vector: wp.array2d[vec3d], norm_out: wp.array[wp.float64]):
    """Euclidean norm of each row."""
    i = wp.tid()
    total = wp.float64(0.0)
    for n in range(vector.shape[1]):
        total += wp.dot(vector[i, n], vector[i, n])
    norm_out[i] = wp.sqrt(total)
