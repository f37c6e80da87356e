"""The step as a graph, as CUDA runs it: captured and replayed on the CPU, since no test may need a GPU."""

import importlib
import os
import pkgutil

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation
from test_simulator import GRIPPER

from defgrasp_ros import simulation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation import contact_set, rows, stepper
from defgrasp_ros.simulation.dense import multiply_rows_by_tiles
from defgrasp_ros.simulation.kernels_element import element_kernels
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.simulation.stepper import StepReport

STEPS = 12
EXTENTS, CELLS = (0.03, 0.03, 0.03), (4, 3, 3)


@pytest.fixture
def counted_graphs(monkeypatch) -> list[wp.Graph]:
    """One shard, little room for contacts, the product of CUDA; the graphs that are launched."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0})
    monkeypatch.setattr(contact_set, "INITIAL_CAPACITY", 8)
    monkeypatch.setattr(stepper, "multiply_rows", multiply_rows_by_tiles)
    launched, launch = [], wp.capture_launch
    monkeypatch.setattr(wp, "capture_launch", lambda graph: (launched.append(graph), launch(graph)))
    return launched


def squeezed_blocks() -> tuple[np.ndarray, list[StepReport], int]:
    """Four blocks squeezed on a platform, each with another force; that of the last one ends as no number."""
    simulator = Simulator(ObjectModel("block", box(EXTENTS, CELLS), Material(2e5)), GRIPPER, 4)
    every, platform = np.arange(4), np.full(4, -0.5 * EXTENTS[2])
    grasp = Grasp(np.zeros(3), Rotation.identity().as_quat())
    simulator.place_platform(every, platform[0])
    simulator.place_gripper(every, [grasp] * 4, np.full(4, 0.5 * EXTENTS[1]), np.ones(4))
    reports = []
    for count in range(1, STEPS + 1):
        force = count / STEPS * np.array([0.5, 1.0, 2.0, 4.0])
        force[3] = np.nan if count == STEPS else force[3]
        some = every if count % 3 else every[1:]
        reports.append(simulator.step(some, 0.005, force[some], platform[some], quasi_static=count < STEPS - 2))
    return simulator.positions(every), reports, simulator._shards[0].contacts.capacity


def test_a_graph_does_what_the_host_does(monkeypatch, counted_graphs):
    """Positions, iterations and residuals are the same to the bit.

    That is so with worlds that leave, contacts that find no room at first, and a step without a solution.
    """
    positions, reports, capacity = squeezed_blocks()
    assert not counted_graphs
    monkeypatch.setattr(rows, "stays_on_device", lambda device: True)
    by_graph, reports_by_graph, capacity_by_graph = squeezed_blocks()
    np.testing.assert_array_equal(by_graph, positions)
    for one, other in zip(reports, reports_by_graph, strict=True):
        for name, values in vars(one).items():
            np.testing.assert_array_equal(vars(other)[name], values, name)
    assert len(counted_graphs) >= STEPS > len(set(map(id, counted_graphs)))  # a graph serves many steps
    assert capacity_by_graph == capacity > 8
    assert list(reports[-1].converged) == [True, True, False] and list(reports[-1].cuts > 0) == [False, False, True]
    assert len({report.iterations.max() for report in reports}) > 1


@pytest.mark.slow
def test_all_kernels_compile_for_cuda(tmp_path):
    """The compiler, which needs no GPU, makes code of compute capability 9.0 from every module."""
    names = [f"{simulation.__name__}.{module.name}" for module in pkgutil.iter_modules(simulation.__path__)]
    modules = [wp.get_module(importlib.import_module(name).__name__) for name in names]
    for kernels in map(element_kernels, (1, 2)):
        modules += [kernel.module for kernel in vars(kernels).values()]
    with_kernels = [module for module in modules if module.kernels]
    for module in with_kernels:
        wp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == len(with_kernels) > 15
