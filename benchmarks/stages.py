"""Times of the stages of a step, taken from outside, and the floors they stand on."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import wraps
from unittest.mock import patch

import numpy as np
import warp as wp

from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.simulation import kernels_elasticity as elastic
from defgrasp_ros.simulation import stepper
from defgrasp_ros.simulation.anderson import DEPTH, Anderson
from defgrasp_ros.simulation.contact_set import ContactSet
from defgrasp_ros.simulation.contact_solver import ContactSolver
from defgrasp_ros.simulation.dense import multiply_rows
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems
from defgrasp_ros.simulation.kernels_element import element_kernels
from defgrasp_ros.simulation.kernels_progress import judge
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.rows import Launcher, RowList
from defgrasp_ros.simulation.stepper import Stepper

ELEMENT_PASS = 0.2e-6
"""Floor of the element pass: processor time per tetrahedron [s]."""
SAMPLES = 8
"""Sizes of products and linear systems that are timed on their own; the others are interpolated."""
REPETITIONS = 3
"""The best of so many bare products or memory passes counts."""

STEP = "step"
METHODS = [
    (Stepper, "step", STEP),
    (Stepper, "_evaluate_residual", "residual"),
    (Stepper, "_refresh_rotations", "rotations"),
    (Stepper, "_correct", "correction"),
    (Stepper, "_apply_compliance", "shared inverse"),
    (stepper, "multiply_rows", "shared product"),
    (Anderson, "mix", "Anderson"),
    (ContactSet, "find", "contact detection"),
    (ContactSet, "complete", "contact detection"),
    (ContactSet, "refresh_compliance", "compliance assembly"),
    (ContactSet, "solve", "contact solve"),
    (ContactSet, "add_forces", "contact residual"),
    (ContactSet, "find_residual", "contact residual"),
    (ContactSet, "take_forces", "contact residual"),
]
"""Owner, attribute and name of each stage; a stage called by another is its child."""
KERNELS = {
    elastic.missing_acceleration: "nodal residual",
    elastic.dynamic_residual: "nodal residual",
    judge: "nodal residual",
    elastic.rotate_back: "turning",
    elastic.rotate: "turning",
    elastic.rotate_and_add: "turning",
    **{element_kernels(order).forces: "element pass" for order in REFERENCE_ELEMENTS},
}
"""Stages that are single kernels."""


@dataclass
class StageTimes:
    """Time and calls of each stage, by its path from the step down."""

    clock: Callable[[], float]
    total: defaultdict[tuple[str, ...], float] = field(default_factory=lambda: defaultdict(float))
    """[s], with that of the children."""
    calls: Counter = field(default_factory=Counter)
    rows: Counter = field(default_factory=Counter)
    """Environments that a stage went over, summed over its calls, by name."""
    products: Counter = field(default_factory=Counter)
    """Calls of the shared product by number of rows."""
    problems: Counter = field(default_factory=Counter)
    """Contact problems by number of points."""
    systems: Counter = field(default_factory=Counter)
    """Linear systems of the contact problems by number of unknowns, of the points that carry force in the end."""
    _path: tuple[str, ...] = ()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Charge what happens inside to a stage."""
        outer = self._path
        self._path = (*outer, name)
        begin = self.clock()
        try:
            yield
        finally:
            self.total[self._path] += self.clock() - begin
            self.calls[self._path] += 1
            self._path = outer

    def of(self, name: str) -> float:
        """Time of all stages of a name [s]."""
        return sum(time for path, time in self.total.items() if path[-1] == name)

    def tree(self) -> Iterator[tuple[int, str, float, int]]:
        """Yield depth, name, time [s] and calls of each stage, the rest of each parent after its children."""

        def visit(path: tuple[str, ...]) -> Iterator[tuple[int, str, float, int]]:
            yield len(path) - 1, path[-1], self.total[path], self.calls[path]
            children = [child for child in self.total if child[:-1] == path]
            for child in sorted(children, key=self.total.__getitem__, reverse=True):
                yield from visit(child)
            if children:
                rest = self.total[path] - sum(self.total[child] for child in children)
                yield len(path), "rest", rest, self.calls[path]

        yield from visit((STEP,))


def thread_clock(device: wp.Device) -> Callable[[], float]:
    """Return the clock of stages: processor time of the thread, on CUDA wall time after all kernels."""
    if not device.is_cuda:
        return time.thread_time

    def synchronised() -> float:
        wp.synchronize_device(device)
        return time.perf_counter()

    return synchronised


@contextmanager
def recorded_stages(clock: Callable[[], float]) -> Iterator[StageTimes]:
    """Time the stages of all steps inside; they must run in one thread, so with one shard."""
    times = StageTimes(clock)
    with ExitStack() as patches:
        for owner, attribute, name in METHODS:
            patches.enter_context(patch.object(owner, attribute, _timed(times, getattr(owner, attribute), name)))
        patches.enter_context(patch.object(Launcher, "__call__", _timed_launch(times)))
        patches.enter_context(patch.object(ContactSolver, "solve", _counted_problems(times)))
        # The parts of a graph could not be timed.
        patches.enter_context(patch.object(stepper, "can_be_captured", lambda device: False))
        yield times


def row_count(rows: RowList) -> int:
    """Return how many rows there are, asking the device."""
    return int(rows.device.count.numpy()[0])


def _timed(times: StageTimes, function: Callable, name: str) -> Callable:
    @wraps(function)
    def call(*arguments, **options):
        if function is multiply_rows:
            times.products[row_count(arguments[0])] += 1
        if name in ("residual", "Anderson", "shared inverse"):
            times.rows[name] += row_count(arguments[1])
        with times.stage(name):
            return function(*arguments, **options)

    return call


def _timed_launch(times: StageTimes) -> Callable:
    launch = Launcher.__call__

    def call(self: Launcher, kernel: wp.Kernel, *arguments) -> None:
        with times.stage(KERNELS[kernel]) if kernel in KERNELS else nullcontext():
            launch(self, kernel, *arguments)

    return call


def _counted_problems(times: StageTimes) -> Callable:
    solve = ContactSolver.solve

    def call(self: ContactSolver, rows: RowList, problems: ContactProblems, *arguments):
        solve(self, rows, problems, *arguments)
        number = row_count(rows)
        counts, systems = problems.count.numpy()[problems.worlds.numpy()[:number]], self.systems.numpy()[:number]
        pressed = (self.force.numpy()[:number, :, 0] > 0.0) & (np.arange(self.force.shape[1]) < counts[:, None])
        times.problems.update(counts.tolist())
        for unknowns, number in zip(3 * pressed.sum(axis=1), systems, strict=True):
            times.systems[int(unknowns)] += int(number)

    return call


def floors(times: StageTimes, mesh: TetMesh, device: wp.Device) -> dict[str, float]:
    """Return the least time that stages could have taken [s], measured now on one core or the device.

    The shared product: the same BLAS calls, bare. The contact solve: its linear systems, bare. The element pass:
    ``ELEMENT_PASS``, on the CPU. The others that go over all nodes: one pass over the bytes they must read and write.
    """
    nodes, entries, tets = len(mesh.vertices), mesh.elements.size, len(mesh.tetrahedra)
    residuals = times.rows["residual"]
    pass_time = memory_pass_time(device)
    result = {"shared product": bare_products(times, 3 * nodes, device), "contact solve": bare_systems(times)}
    if not device.is_cuda:
        result["element pass"] = residuals * tets * ELEMENT_PASS
    # A vector has 24 bytes, a rotation 72. Nodal residual: three fields and the elements' forces in, the
    # acceleration and the residual out and in again.
    result["nodal residual"] = residuals * 24 * (7 * nodes + entries) * pass_time
    # In: the elements' rotations, the nodes' twice; out: the nodes'.
    result["rotations"] = residuals * 72 * (tets + 3 * nodes) * pass_time
    # Twice per product: a rotation and a vector in, a vector out.
    result["turning"] = times.rows["shared inverse"] * 2 * (72 + 48) * nodes * pass_time
    # In: the iterate before and after, images and changes of the history; out: one of each and the mixed iterate.
    result["Anderson"] = times.rows["Anderson"] * 24 * (5 + 2 * (int(DEPTH) + 1)) * nodes * pass_time
    return result


def bare_products(times: StageTimes, size: int, device: wp.Device) -> float:
    """Return the time of all shared products of a run, done alone with BLAS, or with the kernel on CUDA [s]."""
    matrix = wp.array(np.random.default_rng(0).random((size, size)), dtype=wp.float64, device=device)
    clock = thread_clock(device)

    def bare(count: int) -> float:
        rows = RowList(count, device).assign(np.arange(count))
        left, out = (wp.zeros((count, size), dtype=wp.float64, device=device) for _ in range(2))
        left.fill_(1.0)
        return _best(lambda: multiply_rows(rows, left, matrix, out), clock)

    return _total(times.products, bare)


def bare_systems(times: StageTimes) -> float:
    """Return the time of all linear systems of the contact problems, done alone with LAPACK [s]."""

    def bare(size: int) -> float:
        matrix = np.random.default_rng(0).random((size, size)) + size * np.eye(size)
        return _best(lambda: np.linalg.solve(matrix, np.ones(size)), time.thread_time)

    return _total(times.systems, bare)


def _total(calls: Counter, bare: Callable[[int], float]) -> float:
    """Return the time of calls by size [s], some sizes timed, the others interpolated."""
    if not calls:
        return 0.0
    sizes = np.array(sorted(calls))
    sampled = sizes[np.unique(np.linspace(0, len(sizes) - 1, SAMPLES).round().astype(int))]
    each = np.interp(sizes, sampled, [bare(int(size)) for size in sampled])
    return float(each @ [calls[size] for size in sizes])


def memory_pass_time(device: wp.Device, size: int = 2**25) -> float:
    """Return the time per byte read or written of a large copy [s]."""
    source, target = (wp.zeros(size // 8, dtype=wp.float64, device=device) for _ in range(2))
    return _best(lambda: wp.copy(target, source), thread_clock(device)) / (2 * size)


def _best(action: Callable[[], None], clock: Callable[[], float]) -> float:
    action()
    times = []
    for _ in range(REPETITIONS):
        begin = clock()
        action()
        times.append(clock() - begin)
    return min(times)
