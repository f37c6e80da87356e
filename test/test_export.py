"""The log of a run as HDF5 and as tables."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")
pytest.importorskip("sensor_msgs.msg")

import h5py  # noqa: E402
from defgrasp_interfaces.msg import ContactState, EvaluationRequest, FingerContact  # noqa: E402
from recorded_example import BLOCK, GRASPS, MATERIAL, TOPICS, held, stretched, write_log  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from defgrasp_ros.analysis import load_run  # noqa: E402
from defgrasp_ros.analysis.field_notes import field_notes  # noqa: E402
from defgrasp_ros.analysis.hdf5_export import to_world, write_hdf5  # noqa: E402
from defgrasp_ros.analysis.tables import write_tables  # noqa: E402
from defgrasp_ros.commands.export import export  # noqa: E402
from defgrasp_ros.errors import InvalidOptionsError, NotFoundError, RecordingError, ResultCode  # noqa: E402
from defgrasp_ros.evaluation import FINGER_NAMES, EvaluationOptions  # noqa: E402
from defgrasp_ros.gripper import load_gripper  # noqa: E402
from defgrasp_ros.recording import RunLog, Topic, provenance  # noqa: E402
from defgrasp_ros.ros.object_source import RegisteredObject  # noqa: E402
from defgrasp_ros.ros.request_conversion import grasp_to_message, object_to_message  # noqa: E402

NODES, TETS = len(BLOCK.vertices), len(BLOCK.tetrahedra)
MASTER_SHAPES = {
    "grasp_index": (3,),
    "pickup_success": (3,),
    "timed_out": (3, 16),
    "pre_contact_stresses": (3, TETS),
    "stresses_at_force": (3, TETS),
    "stresses_under_gravity": (3, TETS),
    "pre_contact_se": (3,),
    "se_at_force": (3,),
    "se_under_gravity": (3,),
    "pre_contact_positions": (3, NODES, 3),
    "positions_at_force": (3, NODES, 3),
    "positions_under_gravity": (3, NODES, 3),
    "left_contacted_nodes_under_gravity": (3, NODES),
    "right_contacted_nodes_under_gravity": (3, NODES),
    "left_contacted_nodes_under_gravity_initial": (3, NODES),
    "right_contacted_nodes_under_gravity_initial": (3, NODES),
    "stacked_left_node_contacts": (3, 50, NODES, 6),
    "stacked_right_node_contacts": (3, 50, NODES, 6),
    "stacked_left_gripper_contact_points": (3, 50, NODES, 3),
    "stacked_right_gripper_contact_points": (3, 50, NODES, 3),
    "stacked_gripper_positions": (3, 50, 2),
    "stacked_positions": (3, 50, NODES, 3),
    "stacked_stresses": (3, 50, TETS),
    "stacked_forces": (3, 50),
    "stacked_forces_on_nodes": (3, 50, NODES),
    "squeeze_no_gravity_max_force": (3,),
    "squeeze_no_gravity_failed_to_increase": (3,),
    "squeeze_no_gravity_lost_contact": (3,),
    "gripper_distance_at_force": (3,),
    "gripper_force_at_force": (3,),
    "gripper_force_under_gravity": (3,),
    "gripper_positions_under_gravity": (3, 2),
    "initial_desired_force": (3,),
    "corrected_desired_force": (3, 16),
    "directions": (3, 16, 3),
    "reorientation_meshes": (3, 16, 4, NODES, 3),
    "reorientation_stresses": (3, 16, 4, TETS),
    "lin_acc_fail_accs": (3, 16),
    "ang_acc_fail_accs": (3, 16),
    "pure_distances": (3, 2),
    "perp_distances": (3, 2),
    "edge_distances": (3, 2),
    "num_gripper_contacts": (3, 2),
}
"""Datasets of DefGraspSim's result files."""


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return write_log(tmp_path_factory.mktemp("logs"))


@pytest.fixture(scope="module")
def file(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "run.h5"
    write_hdf5(path, load_run(log))
    with h5py.File(path) as content:
        yield content


def test_log_is_read_as_data_classes(log):
    """Object, options (the evaluator's own where the request left them out), results and curves are those written."""
    run = load_run(log.parent)
    assert (run.object_name, run.gripper.name, run.complete, run.notes) == ("block & co", "franka_hand", True, [])
    assert run.options.pickup_hold_time == 4.0 and run.options.return_fields is True
    assert [grasp.evaluation.code for grasp in run.grasps] == [ResultCode.OK, ResultCode.DROPPED, ResultCode.NO_CONTACT]
    np.testing.assert_allclose(run.mesh.vertices, BLOCK.vertices)
    samples = run.grasps[0].samples
    np.testing.assert_allclose(samples.time, [0.0, 0.02, 0.04, 0.06, 0.08])
    np.testing.assert_allclose(samples.values["opening"], [0.020, 0.019, 0.018, 0.017, 0.016])
    assert set(samples.values["right_normal_force"]) == {2.0} and not samples.has("slip")
    assert len(run.grasps[1].samples.time) == 0


def test_root_has_the_datasets_of_the_original(file):
    """Names and shapes are those of DefGraspSim's result files, each with a unit and a meaning."""
    root = {name: dataset.shape for name, dataset in file.items() if isinstance(dataset, h5py.Dataset)}
    assert root == MASTER_SHAPES
    for name in root:
        assert file[name].attrs["meaning"], name
        assert file[name].dtype == np.float32
    assert file["stresses_under_gravity"].attrs["unit"] == "Pa"
    assert file["ang_acc_fail_accs"].attrs["unit"] == "rad/s^2"


def test_a_grasp_that_held_before_the_end_of_the_run_is_a_success(log, tmp_path):
    """A run that is stopped in a later experiment has a code that says so; that the grasp held is still known."""
    run = load_run(log)
    for recorded in run.grasps:
        recorded.evaluation.code = ResultCode.CANCELED
    write_hdf5(tmp_path / "run.h5", run)
    with h5py.File(tmp_path / "run.h5") as file:
        np.testing.assert_array_equal(file["pickup_success"][:], [1.0, np.nan, np.nan])


def test_values_are_those_of_the_log(file):
    """What was measured is there, also in DefGraspSim's axes; what was not is nan, never 0."""
    np.testing.assert_array_equal(file["pickup_success"][:], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(file["lin_acc_fail_accs"][0], np.arange(10.0, 26.0))
    assert np.isnan(file["lin_acc_fail_accs"][1:]).all()
    assert np.isnan(file["ang_acc_fail_accs"][0, 3]) and np.isfinite(np.delete(file["ang_acc_fail_accs"][0], 3)).all()
    np.testing.assert_allclose(file["positions_under_gravity"][0], to_world(stretched(1.1).positions), atol=1e-7)
    assert np.isnan(file["positions_under_gravity"][1]).all()
    np.testing.assert_allclose(file["stresses_at_force"][0], stretched(1.0).von_mises_stress)
    np.testing.assert_allclose(file["stacked_forces"][0, :3], [1.0, 2.0, np.nan])
    assert file["squeeze_no_gravity_max_force"][0] == 2.0 and np.isnan(file["squeeze_no_gravity_lost_contact"][0])
    assert np.isfinite(file["stacked_left_gripper_contact_points"][0, :2, 0]).all()
    for never in ("pre_contact_se", "left_contacted_nodes_under_gravity", "stacked_left_node_contacts"):
        assert np.isnan(file[never][:]).all() and "not recorded" in file[never].attrs["meaning"]


def test_axes_are_those_of_the_original():
    """The first direction, and up, have the coordinates that DefGraspSim stores (y up, origin 1 m high)."""
    np.testing.assert_allclose(to_world([0.0, 0.0, 0.25]), [0.0, 1.25, 0.0])
    np.testing.assert_allclose(to_world([0.0, -0.5, 0.8660254]) - [0.0, 1.0, 0.0], [0.0, 0.8660254, 0.5])


def test_turned_states_are_turned_in_the_world(file):
    """Half a turn about an axis through the centre of mass mirrors the nodes in that axis."""
    state, axis = stretched(1.2).positions, held().reorientation.directions[15]
    volumes = BLOCK.node_volumes
    centre = volumes @ stretched(1.05).positions / volumes.sum()
    away = state - centre
    mirrored = centre + 2.0 * np.outer(away @ axis, axis) - away
    np.testing.assert_allclose(file["reorientation_meshes"][0, 15, 3], to_world(mirrored), atol=1e-6)
    assert np.isnan(file["reorientation_meshes"][0, 14]).all()


def test_own_group_has_names_units_and_reasons(file):
    """Our group says everything by the names of the messages, in the object frame."""
    own = file["defgrasp_ros"]
    assert own["grasp_id"].asstr()[:].tolist() == [grasp.id for grasp in GRASPS]
    assert own["outcome"].asstr()[1] == "DROPPED" and own["message"].asstr()[1] == "it slipped out"
    assert own["max_von_mises_stress"].attrs["unit"] == "Pa" and own["max_von_mises_stress"][0] == 2000.0
    np.testing.assert_array_equal(own["linear_acceleration/is_lower_bound"][0], np.arange(16) < 2)
    assert own["angular_acceleration/reasons"].asstr()[0, 3] == "no solution"
    np.testing.assert_allclose(own["mesh/vertices"][:], BLOCK.vertices)
    assert own["samples/0/opening"].attrs["unit"] == "m" and "slip" not in own["samples/0"]
    np.testing.assert_allclose(own["pickup/0/platform_force"], [2.0, 2.02, 2.04])
    assert own.attrs["provenance.version.defgrasp_ros"] == "1.2.3"


def test_tables(log, tmp_path):
    """One row per grasp, per direction and per sample; units in the heads; empty where nothing was measured."""
    paths = write_tables(tmp_path / "tables", load_run(log))
    assert [path.name for path in paths] == ["grasps.csv", "directions.csv", "time_series.csv", "pickup.csv"]
    grasps, directions, samples, pickup = (list(csv.DictReader(path.open(encoding="utf-8"))) for path in paths)
    assert [row["grasp_id"] for row in grasps] == [grasp.id for grasp in GRASPS]
    assert float(grasps[0]["max_von_mises_stress [Pa]"]) == 2000.0 and grasps[1]["max_von_mises_stress [Pa]"] == ""
    assert grasps[1]["outcome"] == "DROPPED" and grasps[0]["angular_instability [rad/s^2]"] == ""
    assert len(directions) == 16
    assert directions[0]["linear_acceleration_is_lower_bound"] == "1"
    assert directions[3]["angular_acceleration_at_loss [rad/s^2]"] == ""
    assert directions[3]["angular_acceleration_reason"] == "no solution"
    assert math.isclose(float(directions[15]["reorientation_max_deformation_180deg [m]"]), 1e-3 * (1.0 + 63.0 / 64.0))
    assert [float(row["time [s]"]) for row in samples] == [0.0, 0.02, 0.04, 0.06, 0.08]
    assert {row["left_normal_force [N]"] for row in samples} == {"1.0"}
    assert [row["right_normal_force [N]"] for row in pickup] == ["1.0", "1.02", "1.04"]
    assert [row["slip [m]"] for row in pickup] == ["", "0.0", "0.0001"]


def test_cut_log_says_which_grasps_are_missing(tmp_path):
    """A log that ends early is exported as far as it goes; a grasp without a result is not taken for a failed one."""
    run = load_run(write_log(tmp_path, finished=1, close=False))
    assert not run.complete and "not closed" in run.notes[0]
    assert [grasp.finished for grasp in run.grasps] == [True, False, False]
    write_hdf5(tmp_path / "cut.h5", run)
    with h5py.File(tmp_path / "cut.h5") as content:
        np.testing.assert_array_equal(content["pickup_success"][:], [1.0, np.nan, np.nan])
        assert np.isnan(content["initial_desired_force"][1])


def test_grasps_of_the_same_id_have_their_own_curves(tmp_path):
    """Each has its forces and openings, also where the shown grasp's joint states stand between them."""
    grasps = [grasp_to_message(replace(GRASPS[0], id=id)) for id in ("same", "same", "other")]
    request = EvaluationRequest(object=object_to_message(RegisteredObject("block"), MATERIAL), grasps=grasps)
    everyone = Topic("/evaluator/all_joint_states", JointState, depth=10)
    facts = provenance("cpu", {}, load_gripper(), EvaluationOptions())
    with RunLog(tmp_path, "run", [*TOPICS.values(), everyone], facts) as log:
        log.write("/evaluator/request", request, 0)
        for time in (0, 20_000_000):
            for index, opening in enumerate((0.01, 0.02, 0.03)):
                joints = JointState(
                    name=[f"{name}_joint" for name in FINGER_NAMES], position=[opening + 1e-9 * time] * 2
                )
                joints.header.frame_id = grasps[index].id
                log.write(everyone.name, joints, time)
                if index == 1:  # the one that is shown
                    log.write("/evaluator/joint_states", joints, time)
            for index in range(3):
                fingers = [FingerContact(name=name, normal_force=float(index)) for name in FINGER_NAMES]
                log.write("/evaluator/contacts", ContactState(fingers=fingers, grasp_index=index), time)
    for grasp, opening in zip(load_run(log.path).grasps, (0.01, 0.02, 0.03), strict=True):
        np.testing.assert_allclose(grasp.samples.values["opening"], [opening, opening + 0.02])
        np.testing.assert_array_equal(grasp.samples.values["left_normal_force"], [grasp.index] * 2)


def test_log_without_tetrahedra_is_exported(tmp_path):
    """The fields are exported without their mesh; the turned states, which need its centre of mass, are nan."""
    run = load_run(write_log(tmp_path, with_mesh=False))
    assert run.mesh is None and any("tetrahedra" in note for note in run.notes)
    write_hdf5(tmp_path / "run.h5", run)
    with h5py.File(tmp_path / "run.h5") as content:
        assert np.isfinite(content["positions_under_gravity"][0]).all()
        assert np.isnan(content["reorientation_meshes"][:]).all()
        assert "mesh" not in content["defgrasp_ros"]


def test_run_without_grasps_is_exported(log, tmp_path):
    """A request that asks for nothing has nothing to show, and is no error."""
    run = replace(load_run(log), grasps=[])
    write_hdf5(tmp_path / "run.h5", run)
    with h5py.File(tmp_path / "run.h5") as content:
        assert content["pickup_success"].shape == (0,)
    assert write_tables(tmp_path / "tables", run) == []


def test_bad_input_is_named(log, tmp_path):
    """A log that is none, nothing to write, and a place that cannot be written are errors that say so."""
    (tmp_path / "text.mcap").write_text("no log")
    with pytest.raises(RecordingError, match="no MCAP file"):
        load_run(tmp_path / "text.mcap")
    with pytest.raises(NotFoundError, match="gone.mcap"):
        load_run(tmp_path / "gone.mcap")
    with RunLog(tmp_path, "bare", [TOPICS["request"]], {}) as bare:
        bare.write("/evaluator/request", EvaluationRequest(), 1)
    with pytest.raises(RecordingError, match="does not say with which gripper"):
        load_run(bare.path)
    with pytest.raises(InvalidOptionsError, match="--hdf5"):
        export(log)
    with pytest.raises(RecordingError, match="cannot write"):
        write_hdf5(tmp_path / "gone" / "run.h5", load_run(log))
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot write"):
        write_tables(tmp_path / "file", load_run(log))


def test_units_come_from_the_message_definitions():
    """Unit and meaning are read from comments, also where these run over several lines."""
    notes = field_notes("defgrasp_interfaces/msg/GraspMetrics")
    assert notes["strain_energy"].unit == "J"
    assert notes["max_deformation"].meaning.endswith("rigid motion removed.")
    assert notes["pickup_success"].unit == ""
    assert field_notes("defgrasp_interfaces/msg/Material")["youngs_modulus"].unit == "Pa"
