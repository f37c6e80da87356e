"""What arrives in another process while the evaluator simulates, on every topic."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from xml.etree import ElementTree

import numpy as np
import pytest
from ros_processes import isolated_ros, running_evaluator

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import EvaluationOptions, Phase
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper_urdf import WRIST_AXES
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from rclpy.executors import SingleThreadedExecutor  # noqa: E402

from defgrasp_ros.client import EvaluationAnswer, GraspEvaluatorClient  # noqa: E402
from defgrasp_ros.recording import Topic, read_log  # noqa: E402
from defgrasp_ros.ros.topics import (  # noqa: E402
    ALL_JOINT_STATES,
    CLOCK,
    CONTACTS,
    EVALUATIONS,
    JOINT_STATES,
    MARKERS,
    OBJECT_POINTS,
    PUBLISHED,
    ROBOT_DESCRIPTION,
    STATUS,
    WRENCHES,
    qos_profile,
)

BLOCK = box((0.03, 0.04, 0.03), (2, 3, 2))
MATERIAL = Material(youngs_modulus=1e5)
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
OPTIONS = EvaluationOptions(
    experiments="all",
    pickup_hold_time=0.1,
    platform_speed=1.0,
    squeeze_time=0.1,
    time_step=0.02,
    reorientation_speed=30.0,
    max_linear_acceleration=5.0,
    max_angular_acceleration=10.0,
    squeeze_sample_count=2,
)
GRASPS = [Grasp(np.zeros(3), FROM_ABOVE, id="centre"), Grasp(np.array([0.0, 0.002, 0.003]), FROM_ABOVE, id="higher")]
TIMEOUT = 300.0

Heard = dict[Topic, list]


@contextmanager
def listening(*topics: Topic) -> Iterator[Heard]:
    """Collect what arrives on some topics of the evaluator until the end of the block."""
    heard: Heard = defaultdict(list)
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("listener", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    for topic in topics:
        name = topic.name.replace("~", "/defgrasp_evaluator")
        node.create_subscription(topic.message_class, name, heard[topic].append, qos_profile(topic))
    spinner = Thread(target=executor.spin)
    spinner.start()
    try:
        until(lambda: all(node.count_publishers(topic.name.replace("~", "/defgrasp_evaluator")) for topic in topics))
        yield heard
    finally:
        executor.shutdown()
        spinner.join()
        node.destroy_node()
        rclpy.shutdown(context=context)


def until(condition) -> None:
    """Return as soon as the condition holds."""
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Heard, EvaluationAnswer]:
    """Everything heard in this process of a run of two grasps through all experiments, with a log."""
    directory = tmp_path_factory.mktemp("logs")
    parameters = {"publish.clock": "true", "publish.sample_rate": 200.0, "publish.direction": 3}
    with isolated_ros(), running_evaluator(directory, **parameters), GraspEvaluatorClient() as client:
        client.wait_until_ready(TIMEOUT)
        with listening(*PUBLISHED, CLOCK) as heard:
            answer = client.evaluate_grasps(BLOCK, MATERIAL, GRASPS, options=OPTIONS, timeout=TIMEOUT)
            until(lambda: heard[STATUS] and heard[STATUS][-1].state == heard[STATUS][-1].STATE_IDLE)
            return heard, answer


def nanoseconds(stamp) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def test_every_topic_arrives(run: tuple[Heard, EvaluationAnswer]) -> None:
    """Both grasps are held, and there is something on each topic."""
    expected = {topic.name for topic in (*PUBLISHED, CLOCK)}
    heard, answer = run
    assert [evaluation.code for evaluation in answer.evaluations] == [ResultCode.OK] * 2
    assert {topic.name for topic, messages in heard.items() if messages} == expected


def test_log_has_what_was_published(run: tuple[Heard, EvaluationAnswer]) -> None:
    """Message for message on the sampled topics; the URDF is in it once, the clock is not."""
    heard, answer = run
    log = read_log(answer.log_path)
    for topic in (JOINT_STATES, ALL_JOINT_STATES, CONTACTS, *WRENCHES):
        name = topic.name.removeprefix("~/")
        assert [nanoseconds(each.header.stamp) for each in log.on(name)] == [
            nanoseconds(each.header.stamp) for each in heard[topic]
        ]
    assert len(log.on("object_points")) >= len(heard[OBJECT_POINTS]) > 5
    assert [each.data for each in log.on("robot_description")] == [heard[ROBOT_DESCRIPTION][-1].data]


def test_joints_belong_to_the_description(run: tuple[Heard, EvaluationAnswer]) -> None:
    """Each joint is in the URDF; the wrist stands at the grasp's pose, from above: turned half round about x."""
    heard, _ = run
    robot = ElementTree.fromstring(heard[ROBOT_DESCRIPTION][-1].data.encode())
    known = {joint.get("name") for joint in robot.findall("joint")}
    assert {joints.header.frame_id for joints in heard[ALL_JOINT_STATES]} == {"centre", "higher"}
    for joints in heard[JOINT_STATES]:
        assert set(joints.name) <= known and len(joints.name) == 8
        assert joints.header.frame_id == "centre"
        wrist = dict(zip(joints.name, joints.position, strict=True))
        x, y, z, yaw, pitch, roll = (wrist[name] for name in WRIST_AXES)
        np.testing.assert_allclose([x, y, z], [0.0, 0.0, 0.1034], atol=2e-3)  # the block sags on the platform
        np.testing.assert_allclose([yaw, pitch, abs(roll)], [0.0, 0.0, np.pi], atol=1e-2)


def test_wrenches_are_the_contact_forces(run: tuple[Heard, EvaluationAnswer]) -> None:
    """At each instant the wrenches of the shown grasp are the sums of its contact forces; the wrist carries them."""
    heard, _ = run
    contacts = {nanoseconds(each.header.stamp): each for each in heard[CONTACTS] if each.grasp_id == "centre"}
    joints = {nanoseconds(each.header.stamp): each for each in heard[JOINT_STATES]}
    assert len(heard[WRENCHES[0]]) > 20
    for left, right in zip(*(heard[topic] for topic in WRENCHES), strict=True):
        stamp, total = nanoseconds(left.header.stamp), np.zeros(3)
        for finger, wrench in zip(contacts[stamp].fingers, (left, right), strict=True):
            force = np.array(finger.forces).reshape(-1, 3).sum(axis=0)
            assert wrench.header.frame_id == finger.name
            here = wrench.wrench.force
            # The hand points down: its y and z are the object's with the other sign, but for the sag of the object.
            size = np.linalg.norm(force)
            np.testing.assert_allclose([here.x, here.y, here.z], force * [1.0, -1.0, -1.0], atol=0.02 * size + 1e-9)
            assert np.linalg.norm([here.x, here.y, here.z]) == pytest.approx(size)
            total += force
        palm = contacts[stamp].palm_force
        effort = dict(zip(joints[stamp].name, joints[stamp].effort, strict=True))
        carried = [effort[f"wrist_{axis}_joint"] for axis in "xyz"]
        np.testing.assert_allclose(carried, total + [palm.x, palm.y, palm.z], atol=1e-9)


def test_points_are_the_object(run: tuple[Heard, EvaluationAnswer]) -> None:
    """The cloud has the extents of the block, moves with the squeeze, and bears stress."""
    heard, _ = run
    for cloud in heard[OBJECT_POINTS]:
        points = np.frombuffer(cloud.data, np.float32).reshape(-1, 5)
        assert len(points) == len(BLOCK.vertices)
        np.testing.assert_allclose(np.ptp(points[:, :3], axis=0), BLOCK.extents, rtol=0.2)
        assert (points[:, 3:] >= 0.0).all() and points[:, 4].max() > 0.0
    last = np.frombuffer(heard[OBJECT_POINTS][-1].data, np.float32).reshape(-1, 5)
    first = np.frombuffer(heard[OBJECT_POINTS][0].data, np.float32).reshape(-1, 5)
    assert last[:, 3].max() > 1e-4 and last[:, 4].max() > 10.0 * first[:, 4].max()


def test_markers_show_every_phase(run: tuple[Heard, EvaluationAnswer]) -> None:
    """There is a picture of each phase that was simulated, complete each time."""
    heard, _ = run
    texts = set()
    for picture in heard[MARKERS]:
        by_name = {marker.ns: marker for marker in picture.markers}
        assert len(by_name["object"].points) == 3 * len(BLOCK.surface_triangles)
        texts.add(by_name["text"].text.split(":")[1].split(",")[0].strip())
    assert {"squeeze", "hold", "reorient", "accelerate", "squeeze free"} <= texts


def test_status_and_evaluations_tell_of_the_run(run: tuple[Heard, EvaluationAnswer]) -> None:
    """Every phase is reported, each grasp's result, how many there are, and the speed while something is simulated."""
    heard, _ = run
    running = [status for status in heard[STATUS] if status.state == status.STATE_RUNNING]
    assert {Phase.SQUEEZE, Phase.REORIENT, Phase.ACCELERATE} <= {status.phase for status in running}
    assert {status.grasp_count for status in running} == {2}
    assert max(status.finished_grasps for status in heard[STATUS]) == 2
    assert np.nanmax([status.real_time_factor for status in running]) > 0.0
    assert np.isnan(heard[STATUS][-1].real_time_factor)
    assert [evaluation.grasp_id for evaluation in heard[EVALUATIONS]] == ["centre", "higher"]


def test_clock_is_the_time_of_the_stamps(run: tuple[Heard, EvaluationAnswer]) -> None:
    """It never goes back, and covers the stamps of the samples."""
    heard, _ = run
    clock = [nanoseconds(message.clock) for message in heard[CLOCK]]
    stamps = [nanoseconds(joints.header.stamp) for joints in heard[JOINT_STATES]]
    assert clock == sorted(clock) and stamps == sorted(stamps)
    assert clock[0] <= stamps[0] and stamps[-1] <= clock[-1]
