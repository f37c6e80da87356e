"""The benchmark's view of a step from outside fits the simulator as it is."""

import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import warp as wp

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from scenes import HAND, Squeeze, mesh_of
from stages import METHODS, floors, recorded_stages

from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import ObjectModel


def test_hand_is_that_of_the_description():
    """The lengths that the benchmark writes out are those of the gripper's file."""
    assert replace(HAND, name="") == replace(load_gripper(), name="", palm=None)


def test_stages_account_for_the_whole_step():
    """Every stage is met, children take no longer than their parents, corrections are the reported iterations."""
    model = ObjectModel("rectangle", mesh_of("rectangle"), Material())
    squeeze = Squeeze(model, 1, "cpu")
    with recorded_stages(time.thread_time) as times:
        reports = squeeze.run()
    assert all(report.converged.all() and not report.cuts.any() for report in reports)
    met = {path[-1] for path in times.total}
    assert met == {name for *_, name in METHODS} | {"element pass", "nodal residual", "turning"}
    tree = list(times.tree())
    assert all(seconds >= 0.0 for _, _, seconds, _ in tree)
    iterations = sum(int(report.iterations.sum()) for report in reports)
    assert times.rows["Anderson"] == iterations
    assert times.products == {1: 2 * iterations}
    assert times.problems.total() == iterations
    least = floors(times, model.mesh, wp.get_device("cpu"))
    assert least.keys() <= met
    assert all(seconds > 0.0 for seconds in least.values())


def test_patches_are_gone_afterwards():
    """The simulator is left as it was."""
    before = [getattr(owner, attribute) for owner, attribute, _ in METHODS]
    with recorded_stages(time.thread_time):
        assert [getattr(owner, attribute) for owner, attribute, _ in METHODS] != before
    assert [getattr(owner, attribute) for owner, attribute, _ in METHODS] == before


@pytest.mark.parametrize("scene", ["block", "rectangle", "banana", "apple"])
def test_shapes_are_meshes_of_their_size(scene):
    """No element of a generated object is flat."""
    mesh = mesh_of(scene)
    assert len(mesh.vertices) == {"block": 490, "rectangle": 364, "banana": 425, "apple": 2366}[scene]
    assert mesh.volumes.min() > 0.1 * mesh.volumes.mean()
