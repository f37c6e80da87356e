"""Objects and grasps through the evaluator's services, in another process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from ros_processes import isolated_ros, running_evaluator

from defgrasp_ros.errors import DefgraspError, EmptyGraspListError, MeshNotWatertightError, NotFoundError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box

pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from defgrasp_ros.client import GraspEvaluatorClient, MeshFile, RegisteredObject, Surface  # noqa: E402

BLOCK = box((0.03, 0.04, 0.03), (2, 3, 2))
MATERIAL = Material(youngs_modulus=1e5, density=900.0, friction_coefficient=0.5)
SHORT = EvaluationOptions(pickup_hold_time=0.1, platform_speed=1.0, squeeze_time=0.1, time_step=0.02)
TIMEOUT = 100.0


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GraspEvaluatorClient]:
    """A client of an evaluator that knows no object yet."""
    with isolated_ros(), running_evaluator(tmp_path_factory.mktemp("logs")), GraspEvaluatorClient() as client:
        client.wait_until_ready(60.0)
        yield client


def refused(call) -> DefgraspError:
    with pytest.raises(DefgraspError) as caught:
        call()
    return caught.value


def test_life_of_an_object(client: GraspEvaluatorClient) -> None:
    """An object is registered, listed, given grasps, evaluated by its name, replaced and removed."""
    answer = client.register_object(BLOCK, MATERIAL, "block", timeout=TIMEOUT)
    assert answer.object_id == "block"
    assert (answer.vertex_count, answer.tetrahedron_count) == (len(BLOCK.vertices), len(BLOCK.tetrahedra))
    assert answer.mass == pytest.approx(900.0 * BLOCK.volume)
    assert answer.default_target_force == pytest.approx(1.3 * answer.mass * 9.81 / 0.5)
    np.testing.assert_allclose([answer.extents.x, answer.extents.y, answer.extents.z], BLOCK.extents)
    listed = client.list_objects(TIMEOUT)
    assert list(listed.object_ids) == ["block"] and "kidney" in listed.library

    grasps = client.sample_grasps("block", 3, seed=4, timeout=TIMEOUT)
    assert len(grasps) == 3
    again = client.sample_grasps("block", 3, seed=4, timeout=TIMEOUT)
    assert [g.position.tolist() for g in grasps] == [g.position.tolist() for g in again]
    evaluated = client.evaluate_grasps(
        RegisteredObject("block"), MATERIAL, grasps[:1], options=SHORT, record=False, timeout=TIMEOUT
    )
    assert evaluated.evaluations[0].code in (ResultCode.OK, ResultCode.DROPPED)

    error = refused(lambda: client.register_object(BLOCK, MATERIAL, "block", timeout=TIMEOUT))
    assert error.code == ResultCode.INCORRECT_STATE and "registered already" in str(error)
    heavy = client.register_object(BLOCK, Material(density=2e3), "block", replace=True, timeout=TIMEOUT)
    assert heavy.mass == pytest.approx(2e3 * BLOCK.volume)
    client.remove_object("block", TIMEOUT)
    assert list(client.list_objects(TIMEOUT).object_ids) == []
    with pytest.raises(NotFoundError, match="'block'"):
        client.remove_object("block", TIMEOUT)


def test_library_needs_no_registration(client: GraspEvaluatorClient) -> None:
    """Grasps are sampled for an object of the library by its name, for another gripper and by another sampler."""
    assert len(client.sample_grasps("strawberry", 4, gripper="round_pads", timeout=TIMEOUT)) == 4
    assert len(client.sample_grasps("strawberry", 4, sampler="surface", timeout=TIMEOUT)) == 4


def test_mends_and_warnings_are_answered(client: GraspEvaluatorClient) -> None:
    """What was mended of a surface is told to the caller."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    source = Surface(ball.vertices, ball.faces[1:], target_edge_length=0.01)
    answer = client.register_object(source, MATERIAL, "ball", timeout=TIMEOUT)
    assert any("small hole" in mend for mend in answer.mends)


def test_refusals_have_codes_and_reasons(client: GraspEvaluatorClient, tmp_path: Path) -> None:
    """Each bad request is answered with its code, and the evaluator goes on."""
    open_box = trimesh.creation.box([0.04] * 3)
    surface = Surface(open_box.vertices, open_box.faces[:-2])
    with pytest.raises(MeshNotWatertightError, match="object.surface"):
        client.register_object(surface, MATERIAL, "open", timeout=TIMEOUT)
    with pytest.raises(NotFoundError, match="absent.stl"):
        client.register_object(MeshFile(tmp_path / "absent.stl"), MATERIAL, "absent", timeout=TIMEOUT)
    with pytest.raises(NotFoundError, match="'unicorn' is neither registered"):
        client.sample_grasps("unicorn", timeout=TIMEOUT)
    with pytest.raises(NotFoundError, match="gripper 'claw'"):
        client.sample_grasps("sphere", gripper="claw", timeout=TIMEOUT)
    assert refused(lambda: client.register_object(BLOCK, MATERIAL, "", timeout=TIMEOUT)).code == ResultCode.INVALID_MESH
    error = refused(lambda: client.sample_grasps("sphere", sampler="lucky", timeout=TIMEOUT))
    assert error.code == ResultCode.INVALID_OPTIONS
    crate = box((0.3, 0.3, 0.3), (2, 2, 2))
    client.register_object(crate, MATERIAL, "crate", timeout=TIMEOUT)
    with pytest.raises(EmptyGraspListError, match="wider than the gripper opens"):
        client.sample_grasps("crate", 1, timeout=TIMEOUT)
