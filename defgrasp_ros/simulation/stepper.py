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
from defgrasp_ros.simulation.rows import Launcher, RowList, Rows, world_of
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
        self._launch = Launcher(device)

        def zeros(columns: int, dtype) -> wp.array:
            return wp.zeros((world_count, columns), dtype=dtype, device=device)

        self._element_rotation = zeros(model.tet_count, mat33d)
        self._element_force = zeros(model.entry_count, vec3d)
        self._node_rotation, self._start_rotation = (zeros(model.node_count, mat33d) for _ in range(2))
        self._residual, self._correction, self._before = (zeros(model.node_count, vec3d) for _ in range(3))
        self._turned, self._product = (zeros(3 * model.node_count, wp.float64) for _ in range(2))
        self._turned_vectors, self._product_vectors = (
            wp.array(ptr=a.ptr, dtype=vec3d, shape=(world_count, model.node_count), device=device)
            for a in (self._turned, self._product)
        )
        self._anderson = Anderson(world_count, model.node_count, contacts.capacity, device)
        self._norm, self._inverted = (wp.zeros(world_count, dtype=wp.float64, device=device) for _ in range(2))
        self._rows = RowList(world_count, device)

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
        contacts, h = self._contacts, shared.step_length
        report = StepReport.empty(len(worlds))
        self._begin(self._rows.assign(worlds), shared)

        self._forget(worlds)
        count = len(worlds)
        active = np.arange(count)
        last_residual, best_residual = np.full(count, np.inf), np.full(count, np.inf)
        stalled, spent, searches, accelerated = (np.zeros(count, dtype=int) for _ in range(4))
        while len(active):
            residual = self._evaluate_residual(self._rows.assign(worlds[active]), shared) / force_scale[active]
            report.residual[active] = residual
            stalled[active] = np.where(residual < best_residual[active], 0, stalled[active] + 1)
            best_residual[active] = np.fmin(best_residual[active], residual)
            goes_on = np.isfinite(residual) & (stalled[active] <= MAX_STALLED) & (spent[active] < MAX_ITERATIONS)
            solved = residual < TOLERANCE
            if solved.any():
                incomplete = solved.copy()
                incomplete[solved] = contacts.complete(self._rows.assign(worlds[active[solved]]), shared)
                report.converged[active[solved & ~incomplete]] = True
                again = active[incomplete]
                self._forget(worlds[again])
                searches[again] += 1
                spent[again], stalled[again], best_residual[again] = 0, 0, np.inf
                goes_on = np.where(solved, incomplete & (searches[active] <= MAX_SEARCHES), goes_on)
            active = active[goes_on]
            if not len(active):
                break
            grows = report.residual[active] > RESTART_GROWTH * last_residual[active]
            restarts = active[grows & (accelerated[active] >= int(DEPTH))]
            self._forget(worlds[restarts])
            accelerated[restarts] = 0
            accelerated[active] += 1
            last_residual[active] = report.residual[active]
            report.iterations[active] += 1
            spent[active] += 1
            reduction = np.maximum(CONTACT_TOLERANCE, CONTACT_REDUCTION * report.residual[active])
            tolerance = force_scale[active] * reduction
            report.contact_fallbacks[active] += self._correct(self._rows.assign(worlds[active]), shared, tolerance)

        self._accept(worlds[report.converged], h, quasi_static)
        report.crushed = self._are_crushed(worlds)
        self._stand_still(worlds[report.converged & (report.iterations == 0)])
        self._go_back(worlds[~report.converged])
        return report

    def _begin(self, rows: RowList, shared: SharedCompliance) -> None:
        """Remember where the step begins; guess where it ends."""
        state, contacts, h = self._state, self._contacts, shared.step_length
        contacts.expect_step(rows.worlds, h)
        contacts.remember(rows)
        self._launch(_copy_rotations, (rows, self._model.node_count), [state.rotation, self._start_rotation])
        self._predict(rows, state.start_velocity, h)
        contacts.find(rows, shared)
        contacts.extrapolate(rows, h)
        self._predict(rows, state.trend, h)

    def _predict(self, rows: RowList, velocity: wp.array, h: float) -> None:
        """Put the nodes where a velocity takes them, and the fingers where the contact forces do."""
        inputs = [h, self._state.start_displacement, velocity, self._state.displacement]
        self._launch(elastic.predict, (rows, self._model.node_count), inputs)
        self._move_fingers(rows, h)

    def _forget(self, worlds: np.ndarray) -> None:
        """Start the acceleration of some worlds anew."""
        if self._contacts.capacity != self._anderson.capacity:
            world_count = self._norm.shape[0]
            self._anderson = Anderson(world_count, self._model.node_count, self._contacts.capacity, self._device)
        set_entries(self._anderson.length, worlds, 0)

    def _evaluate_residual(self, rows: RowList, shared: SharedCompliance) -> np.ndarray:
        """Leave the nodal residual in its buffer; return the worse of nodal and contact residual [N]."""
        model, state, nodes = self._model, self._state, (rows, self._model.node_count)
        inputs = [model.elements, model.gradients, model.volumes, model.lame, state.displacement]
        self._launch(
            model.kernels.forces, (rows, model.tet_count), [*inputs, self._element_rotation, self._element_force]
        )
        inputs = [model.vertices, shared.step_length, state.gravity, state.spin]
        motion = [state.start_displacement, state.start_velocity, state.displacement]
        acceleration = self._correction  # of no use here
        self._launch(elastic.missing_acceleration, nodes, [*inputs, *motion, acceleration])
        inputs = [model.incidence_start, model.incidence_entry, model.mass_start, model.mass_node, model.mass]
        self._launch(elastic.dynamic_residual, nodes, [*inputs, acceleration, self._element_force, self._residual])
        self._refresh_rotations(rows, shared)
        self._contacts.add_forces(rows, self._residual)
        self._launch(_norms, (rows,), [self._residual, self._norm])
        return np.maximum(self._norm.numpy()[rows.worlds], self._contacts.residual(rows))

    def _refresh_rotations(self, rows: RowList, shared: SharedCompliance) -> None:
        """Follow the nodes' rotations where they have changed too much."""
        model, state = self._model, self._state
        inputs = [model.incidence_start, model.incidence_tet, model.volumes, self._element_rotation]
        self._launch(elastic.nodal_rotations, (rows, model.node_count), [*inputs, self._node_rotation])
        inputs = [self._node_rotation, shared.rotation_tolerance, state.rotation, self._contacts.stale]
        self._launch(elastic.refresh_rotations, (rows,), inputs)

    def _correct(self, rows: RowList, shared: SharedCompliance, contact_tolerance: np.ndarray) -> np.ndarray:
        """One correction of displacement, opening and forces; return which rows had a hard contact problem."""
        nodes, displacement, contacts = (rows, self._model.node_count), self._state.displacement, self._contacts
        self._launch(_copy_vectors, nodes, [displacement, self._before])
        contacts.refresh_compliance(rows, shared)
        self._apply_compliance(rows, shared)
        hard = contacts.solve(rows, self._correction, contact_tolerance)
        self._launch(elastic.add_correction, nodes, [self._correction, displacement, self._residual])
        contacts.add_force_change(rows, self._residual)
        self._apply_compliance(rows, shared)
        self._launch(elastic.add_correction, nodes, [self._correction, displacement, self._residual])
        self._anderson.mix(rows, self._before, displacement, contacts.lists.count, contacts.lists.force)
        self._move_fingers(rows, shared.step_length)
        return hard

    def _apply_compliance(self, rows: RowList, shared: SharedCompliance) -> None:
        """correction = R P R^T residual."""
        nodes, rotation = (rows, self._model.node_count), self._state.rotation
        self._launch(elastic.rotate_back, nodes, [rotation, self._residual, self._turned_vectors])
        multiply_rows(rows.count, self._turned, shared.matrix, self._product)
        self._launch(elastic.rotate, nodes, [rotation, self._product_vectors, self._correction])

    def _move_fingers(self, rows: RowList, h: float) -> None:
        state = self._state
        inputs = [self._contacts.lists, h, state.finger_damping, state.closing_force, state.start_opening]
        self._launch(contact.move_fingers, (rows,), [*inputs, state.bodies.opening])

    def _accept(self, worlds: np.ndarray, h: float, quasi_static: bool) -> None:
        """The end of the step becomes the start of the next."""
        state, rows = self._state, self._rows.assign(worlds)
        self._contacts.find_trends(rows, h)
        inputs = [h, 0.0 if quasi_static else 1.0, state.displacement]
        motion = [state.start_displacement, state.start_velocity, state.trend]
        self._launch(elastic.accept_step, (rows, self._model.node_count), [*inputs, *motion])
        set_entries(state.start_opening, worlds, state.bodies.opening.numpy()[worlds])

    def _stand_still(self, worlds: np.ndarray) -> None:
        """Forget the trends of worlds that needed no iteration: nothing else would end a drift below the tolerance."""
        rows = self._rows.assign(worlds)
        self._launch(clear_rows, (rows, self._model.node_count), [self._state.trend])
        self._contacts.forget_trends(rows)

    def _are_crushed(self, worlds: np.ndarray) -> np.ndarray:
        """Return which worlds have more than a few elements turned inside out."""
        model, inverted = self._model, self._inverted
        inputs = [model.elements, model.gradients, model.volumes, self._state.start_displacement, inverted]
        self._launch(model.kernels.inversions, (self._rows.assign(worlds),), inputs)
        return inverted.numpy()[worlds] > MAX_INVERTED_SHARE * model.volume

    def _go_back(self, worlds: np.ndarray) -> None:
        """Leave no trace of a step that failed."""
        state, rows = self._state, self._rows.assign(worlds)
        nodes = (rows, self._model.node_count)
        self._contacts.go_back(rows)
        self._launch(clear_rows, nodes, [state.trend])
        self._launch(_copy_rotations, nodes, [self._start_rotation, state.rotation])
        set_entries(state.bodies.opening, worlds, state.start_opening.numpy()[worlds])


@wp.kernel
def _copy_vectors(rows: Rows, source: wp.array2d[vec3d], target: wp.array2d[vec3d]):
    """Copy a nodal field of some worlds."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w >= 0:
        target[w, n] = source[w, n]


@wp.kernel
def _copy_rotations(rows: Rows, source: wp.array2d[mat33d], target: wp.array2d[mat33d]):
    """The same with rotations."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w >= 0:
        target[w, n] = source[w, n]


@wp.kernel
def _norms(rows: Rows, vector: wp.array2d[vec3d], norm_out: wp.array[wp.float64]):
    """Euclidean norm of the field of each world."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    total = wp.float64(0.0)
    for n in range(vector.shape[1]):
        total += wp.dot(vector[w, n], vector[w, n])
    norm_out[w] = wp.sqrt(total)
