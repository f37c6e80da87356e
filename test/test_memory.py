"""What is planned for against what is allocated."""

import gc

import numpy as np
import pytest
import warp as wp

from defgrasp_ros.errors import ResourceExhaustedError
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.experiments import evaluate
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation import memory
from defgrasp_ros.simulation.contact_set import INITIAL_CAPACITY
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.simulation.shard import Shard
from defgrasp_ros.simulation.shared_compliance import KEPT, ComplianceCache


def block(order: int = 1) -> ObjectModel:
    """A block of 20 mm."""
    mesh = box([0.02, 0.02, 0.02], [6, 6, 6])
    return ObjectModel("block", TetMesh(mesh.vertices, mesh.tetrahedra, element_order=order), Material())


def allocated(model: ObjectModel, world_count: int) -> int:
    """Bytes of all device arrays that a shard of so many worlds makes."""
    device, rest = wp.get_device("cpu"), RestSystem(model)
    constants, compliances = DeviceModel(model, load_gripper(), rest.mass, device), ComplianceCache(rest, device)
    before = {id(a) for a in gc.get_objects() if isinstance(a, wp.array)}
    shard = Shard(constants, compliances, world_count, device)
    made = [a for a in gc.get_objects() if isinstance(a, wp.array) and id(a) not in before]
    assert shard is not None
    return sum(array.capacity for array in made)


@pytest.mark.parametrize("order", [1, 2])
def test_bytes_per_world(order):
    """The estimate is within a tenth of what a world more takes."""
    model = block(order)
    more = (allocated(model, 9) - allocated(model, 1)) / 8
    assert memory.bytes_per_world(model, INITIAL_CAPACITY) == pytest.approx(more, rel=0.1)


def test_no_more_inverses_are_kept_than_planned():
    """Beyond that the one goes that was not needed for longest; made again it is the same."""
    model = block()
    rest, lengths = RestSystem(model), [1e-3 * (k + 1) for k in range(KEPT + 1)]
    compliances = ComplianceCache(rest, wp.get_device("cpu"))
    first, second = compliances[lengths[0]], compliances[lengths[1]]
    for length in (*lengths[2:KEPT], lengths[0], lengths[KEPT]):
        compliances[length]
    planned = memory.shared_bytes(model)
    assert sum(each.matrix.capacity for each in compliances._known.values()) == planned
    assert compliances[lengths[0]] is first
    again = compliances[lengths[1]]
    assert again is not second
    np.testing.assert_array_equal(again.matrix.numpy(), second.matrix.numpy())


def test_too_little_memory_is_said(monkeypatch):
    """Without room for a single world the error says what is needed and what there is."""
    monkeypatch.setattr(memory, "free_host_memory", lambda: 10_000_000)
    with pytest.raises(ResourceExhaustedError, match="343 nodes needs .* GB of memory"):
        memory.worlds_that_fit(block(), wp.get_device("cpu"))


def test_batches_follow_the_memory(monkeypatch):
    """With room for two worlds, five grasps are evaluated in three batches, each of two worlds at most."""
    monkeypatch.setattr(evaluate, "worlds_that_fit", lambda model, device: 2)
    counts = []

    class Counted(evaluate.Simulator):
        def __init__(self, model, gripper, world_count, device):
            counts.append(world_count)
            super().__init__(model, gripper, world_count, device)

    monkeypatch.setattr(evaluate, "Simulator", Counted)
    away = Grasp(position=[0.5, 0.0, 0.0], orientation=[0.0, 0.0, 0.0, 1.0])
    small = ObjectModel("block", box([0.02, 0.02, 0.02], [2, 2, 2]), Material())
    evaluations = evaluate.evaluate_grasps(small, [away] * 5, load_gripper(), EvaluationOptions())
    assert counts == [2] and [e.grasp_index for e in evaluations] == list(range(5))
