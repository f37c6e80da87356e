"""What is published of a running grasp: joints, wrenches, points and markers show the same state."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import Mock
from xml.etree import ElementTree

import numpy as np
import pytest
from ros_processes import isolated_ros
from scipy.spatial.transform import Rotation

from defgrasp_ros.drawing.color_scales import stress_scale
from defgrasp_ros.evaluation import Experiment, FingerContact, GraspSample, NodalFields, Phase
from defgrasp_ros.experiments.directions import DIRECTION_COUNT
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.gripper_urdf import gripper_urdf
from defgrasp_ros.mesh.shapes import box

pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")
rclpy = pytest.importorskip("rclpy")

from sensor_msgs.msg import PointField  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from defgrasp_ros.ros.fields import time_message  # noqa: E402
from defgrasp_ros.ros.joint_states import JOINT_NAMES, sample_to_joint_state  # noqa: E402
from defgrasp_ros.ros.markers import GraspMarkers  # noqa: E402
from defgrasp_ros.ros.outputs import Outputs  # noqa: E402
from defgrasp_ros.ros.parameters import PARAMETERS, declare_parameters, parameter_values  # noqa: E402
from defgrasp_ros.ros.point_cloud import fields_to_point_cloud  # noqa: E402
from defgrasp_ros.ros.run_observer import RunObserver  # noqa: E402
from defgrasp_ros.ros.shown_grasp import ShownGrasp  # noqa: E402
from defgrasp_ros.ros.state_conversion import sample_to_contact_state  # noqa: E402
from defgrasp_ros.ros.topics import (  # noqa: E402
    CLOCK,
    JOINT_STATES,
    MARKERS,
    OBJECT_POINTS,
    PUBLISHED,
    STATUS,
    WRENCHES,
    qos_profile,
    topics_table,
)
from defgrasp_ros.ros.wrenches import sample_to_wrenches  # noqa: E402

HAND = load_gripper()
MESH = box((0.03, 0.04, 0.05), (2, 3, 2))
STAMP = time_message(12_000_000_034)
FROM_ABOVE = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])
POSES = {
    "any": Rotation.from_rotvec([0.3, -1.1, 2.0]),
    "from above": FROM_ABOVE,
    "pads upright, pitch up": Rotation.from_euler("ZYX", [0.7, np.pi / 2, 0.2]),
    "pads upright, pitch down": Rotation.from_euler("ZYX", [-0.4, -np.pi / 2, 1.2]),
    "half a turn": Rotation.from_euler("ZYX", [np.pi, 0.0, np.pi]),
}


def contact(name: str, count: int, seed: int) -> FingerContact:
    """Contacts anywhere."""
    random = np.random.default_rng(seed)
    normals = np.tile([0.0, 1.0, 0.0], (count, 1))
    return FingerContact(name, 0.02 * random.normal(size=(count, 3)), normals, random.normal(size=(count, 3)))


def sample(orientation: Rotation = FROM_ABOVE, index: int = 4, **changes: object) -> GraspSample:
    """A sample of one grasp."""
    fields = NodalFields(MESH.vertices + 0.001, np.linspace(0.0, 2e-3, 36), np.linspace(0.0, 4e3, 36))
    values = {
        "grasp_index": index,
        "grasp_id": f"grasp {index}",
        "grasp": Grasp(np.array([0.1, -0.2, 0.3]), orientation.as_quat()),
        "experiment": Experiment.PICKUP,
        "direction": None,
        "phase": Phase.SQUEEZE,
        "time": 0.5,
        "opening": 0.02,
        "opening_velocity": -0.01,
        "closing_force": 3.0,
        "contacts": (contact("left_finger", 3, 1), contact("right_finger", 2, 2)),
        "palm": contact("palm", 2, 3),
        "platform_force": 0.7,
        "platform_height": -0.02,
        "read_fields": lambda: fields,
    }
    return GraspSample(**(values | changes))


def link_poses(positions: dict[str, float]) -> dict[str, tuple[np.ndarray, Rotation]]:
    """Forward kinematics of the URDF, with nothing but its text: where each link is in ``world``."""
    robot = ElementTree.fromstring(gripper_urdf(HAND).encode())
    poses = {"world": (np.zeros(3), Rotation.identity())}
    joints = robot.findall("joint")
    while len(poses) < len(robot.findall("link")):
        for joint in joints:
            parent, child = (joint.find(end).get("link") for end in ("parent", "child"))
            if parent not in poses or child in poses:
                continue
            place, turn = poses[parent]
            place = place + turn.apply([float(word) for word in joint.find("origin").get("xyz").split()])
            if joint.get("type") != "fixed":
                step = positions[joint.get("name")] * np.array(list(map(float, joint.find("axis").get("xyz").split())))
                if joint.get("type") == "prismatic":
                    place = place + turn.apply(step)
                else:
                    turn = turn * Rotation.from_rotvec(step)
            poses[child] = (place, turn)
    return poses


def test_joints_are_those_of_the_urdf() -> None:
    """Every movable joint of the description is in the joint states, and no other."""
    robot = ElementTree.fromstring(gripper_urdf(HAND).encode())
    movable = {joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"}
    assert movable == set(JOINT_NAMES) and len(JOINT_NAMES) == 8


@pytest.mark.parametrize("orientation", POSES.values(), ids=POSES)
def test_joint_states_put_the_hand_at_its_grasp(orientation: Rotation) -> None:
    """Description and joint states together give the grasp pose, and pads that are open as far as they are."""
    state = sample(orientation)
    joints = sample_to_joint_state(state, HAND, STAMP)
    poses = link_poses(dict(zip(joints.name, joints.position, strict=True)))
    place, turn = poses["gripper_tcp"]
    np.testing.assert_allclose(place, state.grasp.position, atol=1e-6)  # the URDF rounds lengths to six digits
    np.testing.assert_allclose(turn.as_matrix(), state.grasp.rotation, atol=1e-7)
    for finger, side in (("left_finger", 1.0), ("right_finger", -1.0)):
        pad = state.grasp.position + side * 0.02 * state.grasp.rotation[:, 1]
        np.testing.assert_allclose(poses[finger][0], pad, atol=1e-6)
        np.testing.assert_allclose(poses[finger][1].as_matrix(), state.grasp.rotation, atol=1e-7)
    np.testing.assert_array_equal(poses["object"][0], np.zeros(3))
    assert list(joints.velocity) == [-0.01, -0.01, *[0.0] * 6]
    assert joints.header.frame_id == "grasp 4"


@pytest.mark.parametrize("orientation", POSES.values(), ids=POSES)
def test_efforts_do_the_work_of_the_contact_forces(orientation: Rotation) -> None:
    """A small motion of a wrist joint moves the contact points; effort times motion is the work of the forces."""
    state = sample(orientation)
    joints = sample_to_joint_state(state, HAND, STAMP)
    positions = dict(zip(joints.name, joints.position, strict=True))
    touching = (*state.contacts, state.palm)
    points = np.concatenate([each.positions for each in touching])
    forces = np.concatenate([each.forces for each in touching])
    before, turn_before = link_poses(positions)["gripper_base"]
    step = 1e-6
    for name, effort in zip(joints.name[2:], joints.effort[2:], strict=True):
        place, turn = link_poses(positions | {name: positions[name] + step})["gripper_base"]
        moved = place + (turn * turn_before.inv()).apply(points - before)
        assert effort == pytest.approx((forces * (moved - points)).sum() / step, abs=1e-5)
    assert list(joints.effort[:2]) == [-1.5, -1.5]


def test_wrenches_are_the_sums_of_the_contact_forces() -> None:
    """In the finger's own frame: force is the sum, moment is about the middle of the pad face."""
    state = sample(POSES["any"])
    wrenches = sample_to_wrenches(state, STAMP)
    for message, finger, side in zip(wrenches, state.contacts, (1.0, -1.0), strict=True):
        force, torque = message.wrench.force, message.wrench.torque
        np.testing.assert_allclose(
            POSES["any"].apply([force.x, force.y, force.z]), finger.forces.sum(axis=0), atol=1e-12
        )
        local = POSES["any"].inv().apply(finger.positions - state.grasp.position) - [0.0, side * 0.02, 0.0]
        moment = np.cross(local, POSES["any"].inv().apply(finger.forces)).sum(axis=0)
        np.testing.assert_allclose([torque.x, torque.y, torque.z], moment, atol=1e-12)
        assert message.header.frame_id == finger.name


def test_contact_state_has_every_body() -> None:
    """Sums over contacts are those of the sample, the palm's force is a vector."""
    state = sample()
    message = sample_to_contact_state(state, STAMP)
    assert (message.grasp_id, message.grasp_index, message.platform_force) == ("grasp 4", 4, 0.7)
    assert [finger.count for finger in message.fingers] == [3, 2]
    assert message.normal_force == pytest.approx(sum(finger.normal_force for finger in state.contacts))
    palm = state.palm.forces.sum(axis=0)
    np.testing.assert_allclose([message.palm_force.x, message.palm_force.y, message.palm_force.z], palm)


def test_point_cloud_has_every_node() -> None:
    """Read as any consumer does, by the description of its fields, it holds places, displacement and stress."""
    fields = sample().read_fields()
    cloud = fields_to_point_cloud(fields, STAMP)
    assert all(field.datatype == PointField.FLOAT32 and field.count == 1 for field in cloud.fields)
    kind = np.dtype({"names": [f.name for f in cloud.fields], "formats": ["<f4"] * 5, "itemsize": cloud.point_step})
    points = np.frombuffer(cloud.data, kind)
    assert len(points) == cloud.width == len(MESH.vertices) and cloud.row_step == len(cloud.data)
    places = np.stack([points["x"], points["y"], points["z"]], axis=1)
    np.testing.assert_array_equal(places, fields.positions.astype(np.float32))
    np.testing.assert_array_equal(points["displacement"], fields.displacement.astype(np.float32))
    np.testing.assert_array_equal(points["von_mises"], fields.von_mises_stress.astype(np.float32))
    assert cloud.header.frame_id == "world" and cloud.is_dense


def test_markers_draw_the_state() -> None:
    """They replace the last picture, and hold surface, both pads, the frame, every force, the platform and a text."""
    state = sample(POSES["any"])
    fields = state.read_fields()
    clear, *markers = GraspMarkers(MESH, HAND).draw(state, fields, STAMP).markers
    assert clear.action == Marker.DELETEALL
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers)
    assert {marker.header.frame_id for marker in markers} == {"world"}
    by_name = {f"{marker.ns}{marker.id or ''}": marker for marker in markers}
    surface = by_name["object"]
    corners = np.array([[point.x, point.y, point.z] for point in surface.points]).reshape(-1, 3, 3)
    np.testing.assert_array_equal(corners, fields.positions[MESH.surface_triangles])
    assert len(surface.colors) == len(surface.points)
    for pad, side in ((by_name["pads"], 1.0), (by_name["pads1"], -1.0)):
        place = np.array([pad.pose.position.x, pad.pose.position.y, pad.pose.position.z])
        turn = pad.pose.orientation
        np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], state.grasp.orientation)
        inner = POSES["any"].inv().apply(place - state.grasp.position)[1] - side * pad.scale.y / 2.0
        assert inner == pytest.approx(side * state.opening)
    assert len(by_name["contact_forces"].points) == 2 * (3 + 2)
    assert len(by_name["grasp_frame"].points) == len(by_name["grasp_frame"].colors) == 6
    assert {"finger_forces", "finger_forces1", "platform", "text"} <= set(by_name)
    platform = by_name["platform"]
    assert platform.pose.position.z + platform.scale.z / 2.0 == pytest.approx(-0.02)
    assert "grasp 4: squeeze" in by_name["text"].text


def test_markers_without_platform_and_contact() -> None:
    """What is not there is not drawn."""
    nothing = tuple(contact(name, 0, 0) for name in ("left_finger", "right_finger"))
    state = sample(contacts=nothing, platform_height=np.nan)
    names = [marker.ns for marker in GraspMarkers(MESH, HAND).draw(state, state.read_fields(), STAMP).markers]
    assert names == ["", "object", "pads", "pads", "grasp_frame", "text"]


def test_stress_has_the_colors_of_the_pictures() -> None:
    """Each corner has its node's color on the scale of all pictures; without stress all have the first."""
    state = sample()
    fields = state.read_fields()

    def surface_colors(fields: NodalFields) -> np.ndarray:
        surface = GraspMarkers(MESH, HAND).draw(state, fields, STAMP).markers[1]
        return np.array([[color.r, color.g, color.b, color.a] for color in surface.colors])

    stress = fields.von_mises_stress[MESH.surface_nodes]
    expected = stress_scale([stress]).to_rgba(fields.von_mises_stress[MESH.surface_triangles.ravel()])
    np.testing.assert_allclose(surface_colors(fields), expected, atol=1e-6)
    assert np.ptp(expected, axis=0).max() > 0.5
    calm = surface_colors(dataclasses.replace(fields, von_mises_stress=np.zeros(len(MESH.vertices))))
    np.testing.assert_allclose(calm, np.tile(stress_scale([stress]).to_rgba(0.0), (len(calm), 1)), atol=1e-6)


class Listeners:
    """Stands for the outputs: some topics are wanted, what is sent is kept."""

    def __init__(self, *wanted: object):
        self._wanted = wanted
        self.sent: list[tuple[object, object]] = []

    def wanted(self, topic: object) -> bool:
        return topic in self._wanted

    def send(self, topic: object, message: object, time: int) -> None:
        self.sent.append((topic, message))


def shown_grasp(outputs: Listeners, **changes: object) -> ShownGrasp:
    parameters = {"publish.grasp": "", "publish.field_rate": 10.0, "publish.marker_rate": 2.0} | changes
    return ShownGrasp(outputs, MESH, HAND, parameters)


def test_one_grasp_is_shown_until_it_is_finished() -> None:
    """The first is shown, and waited for; then, or in an experiment without it, the first that runs is."""
    outputs = Listeners(JOINT_STATES)
    shown = shown_grasp(outputs)

    def follow(running: list[int], **changes: object) -> list[str]:
        outputs.sent.clear()
        shown.send([sample(index=index, **changes) for index in running], 0)
        return [message.header.frame_id for _, message in outputs.sent]

    assert follow([2, 4, 7]) == follow([1, 2]) == ["grasp 2"]
    assert follow([4, 7]) == []
    shown.finish(7)
    assert follow([4]) == []
    shown.finish(2)
    assert follow([4, 7]) == ["grasp 4"]
    assert follow([1, 7], experiment=Experiment.REORIENTATION) == ["grasp 1"]
    assert follow([7], experiment=Experiment.REORIENTATION) == []


@pytest.mark.parametrize("asked", ["grasp 4", "4"])
def test_grasp_can_be_asked_for(asked: str) -> None:
    """By its id or its index; where it does not run, none is shown."""
    outputs = Listeners(JOINT_STATES, OBJECT_POINTS)
    shown = shown_grasp(outputs, **{"publish.grasp": asked})
    shown.send([sample(index=2), sample(index=4)], 0)
    shown.send([sample(index=2)], 1)
    assert len(outputs.sent) == 2 and outputs.sent[0][1].header.frame_id == "grasp 4"


def test_fields_are_read_only_when_wanted_and_once() -> None:
    """Joints and wrenches need no fields; points and markers share them, at their own rates."""
    reads: list[int] = []

    def at(time: float, phase: Phase = Phase.HOLD) -> Sequence[GraspSample]:
        def read() -> NodalFields:
            reads.append(1)
            return sample().read_fields()

        return [sample(time=time, phase=phase, read_fields=read)]

    outputs = Listeners(JOINT_STATES, *WRENCHES)
    shown_grasp(outputs).send(at(0.0), 0)
    assert [topic for topic, _ in outputs.sent] == [JOINT_STATES, *WRENCHES] and not reads
    outputs = Listeners(OBJECT_POINTS, MARKERS)
    shown = shown_grasp(outputs)
    for moment, phase in ((0.0, Phase.HOLD), (0.05, Phase.HOLD), (0.1, Phase.HOLD), (0.15, Phase.REORIENT)):
        shown.send(at(moment, phase), 0)
    assert [topic for topic, _ in outputs.sent] == [OBJECT_POINTS, MARKERS, OBJECT_POINTS, MARKERS]
    assert len(reads) == 3
    shown_grasp(Listeners()).send(at(0.0), 0)
    assert len(reads) == 3


def test_samples_are_wanted_while_somebody_listens(tmp_path: Path) -> None:
    """Without listener and log nothing is read from the simulator; a listener or a log changes that at once."""
    with isolated_ros():
        rclpy.init()
        node = rclpy.create_node("evaluator")
        try:
            declare_parameters(node)
            outputs = Outputs(node)
            grasps = {0: sample().grasp}
            observer = RunObserver(
                outputs,
                Mock(),
                grasps,
                MESH,
                HAND,
                parameter_values(node),
                return_fields=False,
                start_time=0,
            )
            assert not observer.wants_samples()
            outputs.start_log(tmp_path, "run", {})
            assert observer.wants_samples() and not outputs.wanted(CLOCK)
            outputs.end_log()
            assert not observer.wants_samples()
            for topic in (STATUS, MARKERS):
                node.create_subscription(topic.message_class, topic.name, print, qos_profile(topic))
                deadline = time.monotonic() + 60.0
                while not outputs.wanted(topic) and time.monotonic() < deadline:
                    time.sleep(0.01)
                assert outputs.wanted(topic) and observer.wants_samples() == (topic is MARKERS)
        finally:
            node.destroy_node()
            rclpy.shutdown()


def test_directions_of_the_parameter_are_those_that_there_are() -> None:
    """The range of ``publish.direction`` ends with the last direction."""
    (parameter,) = [parameter for parameter in PARAMETERS if parameter.name == "publish.direction"]
    assert parameter.range == (0, DIRECTION_COUNT - 1)


def test_quality_of_service_on_the_wire_is_that_of_the_log() -> None:
    """Topics are published with the profile that their log states."""
    for topic in (*PUBLISHED, CLOCK):
        profile, offered = qos_profile(topic), topic.offered_qos_profile
        assert profile.depth == offered["depth"]
        assert profile.reliability.name.lower() == offered["reliability"]
        assert profile.durability.name.lower() == offered["durability"]


def test_documented_topics_are_those_of_the_table() -> None:
    """docs/topics.md holds the table that ``python -m defgrasp_ros.ros.topics`` prints."""
    assert topics_table() in (Path(__file__).parents[1] / "docs" / "topics.md").read_text()
