"""One implicit time step of some worlds: the quasi-Newton iteration with exact contact.

One step of length h from (u_n, v_n, q_n) finds displacement u, opening q and contact forces lambda with

    M (u - u_n - h v_n) / h^2 = M g + f_elastic(u) + J^T lambda,      c (q - q_n) / h = sum lambda_n(pads) - F,

under the exact laws of contact (``kernels_coulomb``). Each iteration corrects with the shared inverse P of the rest
state, turned by the nodal rotations R:

    y = R P R^T residual;    solve the contact laws for lambda' with  w = w(u + y) + W (lambda' - lambda);
    u <- u + y + R P R^T J^T (lambda' - lambda).

Anderson acceleration mixes it with the iterates before (:mod:`anderson`). The fixed point satisfies the equations above
whatever P is. A step counts as solved when both residuals, that of the nodes and that of the contacts, are below a
tolerance of the world's force scale.

Kernels judge that (``kernels_progress``), so that the host need not look at the device before the step is over: on CUDA
the whole step is one graph.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from defgrasp_ros.simulation import kernels_contact as contact
from defgrasp_ros.simulation import kernels_elasticity as elastic
from defgrasp_ros.simulation.anderson import Anderson
from defgrasp_ros.simulation.contact_set import ContactSet
from defgrasp_ros.simulation.dense import multiply_rows
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.kernels_progress import (
    CONVERGED,
    FAILED,
    RUNNING,
    SOLVED,
    begin_step,
    decide,
    judge,
    new_progress,
)
from defgrasp_ros.simulation.rows import Launcher, RowList
from defgrasp_ros.simulation.shared_compliance import SharedCompliance
from defgrasp_ros.simulation.types import mat33d, vec3d
from defgrasp_ros.simulation.world_state import WorldState, set_entries

MAX_INVERTED_SHARE = 1e-3
"""Part of a body's volume that may be turned inside out [-]: a sliver or two of the mesh hold next to nothing."""


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
    """Work buffers of some worlds, and how they are stepped."""

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
        self._inverted = wp.zeros(world_count, dtype=wp.float64, device=device)
        self._anderson = Anderson(world_count, model.node_count, contacts.capacity, device)
        self._progress = new_progress(world_count, device)
        self._stepped, self._active, self._solved, self._converged, self._failed = (
            RowList(world_count, device) for _ in range(5)
        )
        self._graphs: WeakKeyDictionary[SharedCompliance, dict[bool, wp.Graph]] = WeakKeyDictionary()

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
        self._stepped.assign(worlds)
        set_entries(self._progress.force_scale, worlds, force_scale)
        self._remember(shared)
        while True:
            self._follow_growth()
            self._run(shared, quasi_static)
            report, room = self._read_report(worlds)
            if room <= self._contacts.capacity:
                return report
            self._begin_anew(room)

    def _run(self, shared: SharedCompliance, quasi_static: bool) -> None:
        """Try the step; where the host stays out of it, as one graph."""
        if not (self._stepped.stays_on_device and can_be_captured(self._device)):
            self._try_step(shared, quasi_static)
            return
        graphs = self._graphs.setdefault(shared, {})
        if quasi_static not in graphs:
            with wp.ScopedCapture(self._device) as capture:
                self._try_step(shared, quasi_static)
            graphs[quasi_static] = capture.graph
        wp.capture_launch(graphs[quasi_static])

    def _try_step(self, shared: SharedCompliance, quasi_static: bool) -> None:
        """Guess, iterate, and take over what came out; leave all as it was where contacts have found no room."""
        self._guess(shared)
        wp.capture_while(self._active.device.count, self._iterate, shared=shared)
        self._accept(shared, quasi_static)
        self._go_back()

    def _iterate(self, shared: SharedCompliance) -> None:
        """One iteration of the worlds that still go on."""
        contacts, progress, history = self._contacts, self._progress, self._anderson.length
        self._evaluate_residual(self._active, shared)
        self._launch(judge, (self._active,), [self._residual, contacts.residual, progress])
        self._select(self._active, SOLVED, self._solved)
        if self._solved.count:
            contacts.complete(self._solved, shared)
        self._launch(decide, (self._active,), [contacts.missing, progress, history])
        self._select(self._stepped, RUNNING, self._active)
        if self._active.count:
            self._correct(self._active, shared)

    def _select(self, rows: RowList, state: int, selected: RowList) -> None:
        """List those of some worlds that are in a state; none where contacts have found no room."""
        selected.select(rows, self._progress.state, state, self._contacts.longest, self._contacts.capacity)

    def _remember(self, shared: SharedCompliance) -> None:
        """Keep what a step changes before it is accepted."""
        rows, nodes = self._stepped, self._model.node_count
        self._contacts.remember(rows, shared.step_length)
        self._launch(elastic.copy_rotations, (rows, nodes), [self._state.rotation, self._start_rotation])

    def _begin_anew(self, room: int) -> None:
        """Make room for the contacts, and go back to where the step began."""
        rows, nodes = self._stepped, self._model.node_count
        self._contacts.begin_anew(rows, room)
        self._launch(elastic.copy_rotations, (rows, nodes), [self._start_rotation, self._state.rotation])

    def _follow_growth(self) -> None:
        """Make anew what belongs to buffers of contacts that are no longer used."""
        capacity = self._contacts.capacity
        if self._anderson.capacity != capacity:
            world_count, nodes = self._residual.shape
            self._anderson = Anderson(world_count, nodes, capacity, self._device)
            self._graphs.clear()

    def _guess(self, shared: SharedCompliance) -> None:
        """Guess where the step ends: contacts are looked for where the velocity leads, the rest follows the trends."""
        state, contacts, rows, h = self._state, self._contacts, self._stepped, shared.step_length
        self._predict(rows, state.start_velocity, h)
        contacts.find(rows, shared)
        contacts.extrapolate(rows, h)
        self._predict(rows, state.trend, h)
        self._launch(begin_step, (rows,), [self._progress, self._anderson.length])
        self._select(rows, RUNNING, self._active)

    def _predict(self, rows: RowList, velocity: wp.array, h: float) -> None:
        """Put the nodes where a velocity takes them, and the fingers where the contact forces do."""
        inputs = [h, self._state.start_displacement, velocity, self._state.displacement]
        self._launch(elastic.predict, (rows, self._model.node_count), inputs)
        self._move_fingers(rows, h)

    def _evaluate_residual(self, rows: RowList, shared: SharedCompliance) -> None:
        """Leave the residuals of the nodes and of the contacts in their buffers."""
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
        self._contacts.find_residual(rows)

    def _refresh_rotations(self, rows: RowList, shared: SharedCompliance) -> None:
        """Follow the nodes' rotations where they have changed too much."""
        model, state = self._model, self._state
        inputs = [model.incidence_start, model.incidence_tet, model.volumes, self._element_rotation]
        self._launch(elastic.nodal_rotations, (rows, model.node_count), [*inputs, self._node_rotation])
        inputs = [self._node_rotation, shared.rotation_tolerance, state.rotation, self._contacts.stale]
        self._launch(elastic.refresh_rotations, (rows,), inputs)

    def _correct(self, rows: RowList, shared: SharedCompliance) -> None:
        """One correction of displacement, opening and forces."""
        state, contacts, progress, nodes = self._state, self._contacts, self._progress, (rows, self._model.node_count)
        contacts.refresh_compliance(rows, shared)
        self._apply_compliance(rows, shared)
        self._launch(elastic.rotate, nodes, [state.rotation, self._product_vectors, self._correction])
        contacts.solve(rows, self._correction, progress.contact_tolerance)
        self._launch(
            elastic.add_correction, nodes, [self._correction, state.displacement, self._before, self._residual]
        )
        contacts.take_forces(rows, self._residual, progress.hard)
        self._apply_compliance(rows, shared)
        self._launch(elastic.rotate_and_add, nodes, [state.rotation, self._product_vectors, state.displacement])
        self._anderson.mix(rows, self._before, state.displacement, contacts.lists.count, contacts.lists.force)
        self._move_fingers(rows, shared.step_length)

    def _apply_compliance(self, rows: RowList, shared: SharedCompliance) -> None:
        """product = P R^T residual, still to be turned forth."""
        inputs = [self._state.rotation, self._residual, self._turned_vectors]
        self._launch(elastic.rotate_back, (rows, self._model.node_count), inputs)
        multiply_rows(rows, self._turned, shared.matrix, self._product)

    def _move_fingers(self, rows: RowList, h: float) -> None:
        state = self._state
        inputs = [self._contacts.lists, h, state.finger_damping, state.closing_force, state.start_opening]
        self._launch(contact.move_fingers, (rows,), [*inputs, state.bodies.opening])

    def _accept(self, shared: SharedCompliance, quasi_static: bool) -> None:
        """The end of the step becomes the start of the next, where there is one; look for elements inside out."""
        model, state, rows, h = self._model, self._state, self._converged, shared.step_length
        iterations = self._progress.iterations
        self._select(self._stepped, CONVERGED, rows)
        self._contacts.find_trends(rows, h, iterations)
        inputs = [h, 0.0 if quasi_static else 1.0, iterations, state.displacement]
        motion = [state.start_displacement, state.start_velocity, state.trend]
        opening = [state.bodies.opening, state.start_opening]
        self._launch(elastic.accept_step, (rows, model.node_count), [*inputs, *motion, *opening])
        inputs = [model.elements, model.gradients, model.volumes, state.start_displacement, self._inverted]
        self._launch(model.kernels.inversions, (self._stepped,), inputs)

    def _go_back(self) -> None:
        """Leave no trace of a step that failed."""
        state, rows = self._state, self._failed
        self._select(self._stepped, FAILED, rows)
        self._contacts.go_back(rows)
        inputs = [self._start_rotation, state.start_opening, state.rotation, state.bodies.opening, state.trend]
        self._launch(elastic.take_back_step, (rows, self._model.node_count), inputs)

    def _read_report(self, worlds: np.ndarray) -> tuple[StepReport, int]:
        """Return the report, and how much room the contacts need; void if they do not have it."""
        progress = self._progress
        report = StepReport(
            converged=progress.state.numpy()[worlds] == CONVERGED,
            iterations=progress.iterations.numpy()[worlds].astype(int),
            residual=progress.residual.numpy()[worlds],
            cuts=np.zeros(len(worlds), dtype=int),
            contact_fallbacks=progress.hard.numpy()[worlds].astype(int),
            crushed=self._inverted.numpy()[worlds] > MAX_INVERTED_SHARE * self._model.volume,
        )
        return report, int(self._contacts.longest.numpy()[0])


def can_be_captured(device: wp.Device) -> bool:
    """Whether a loop can be part of a graph on a device."""
    return device.is_cpu or wp.is_conditional_graph_supported()
