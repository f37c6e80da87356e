"""The evaluator as a planner meets it: another process that answers every request, also the impossible ones."""

from __future__ import annotations

import copy
import dataclasses
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from ros_processes import STOP_TIMEOUT, isolated_ros, running_evaluator

from defgrasp_ros.errors import InvalidMaterialError, MeshNotWatertightError, NotFoundError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions, Experiment, Phase, Progress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box

pytest.importorskip("rclpy")
msg = pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from defgrasp_ros.analysis import load_run  # noqa: E402
from defgrasp_ros.analysis.report_page import render  # noqa: E402
from defgrasp_ros.client import EvaluatorGoneError, GraspEvaluatorClient, MeshFile, Surface  # noqa: E402
from defgrasp_ros.recording import read_log  # noqa: E402
from defgrasp_ros.ros.request_conversion import grasp_to_message, object_to_message, options_to_message  # noqa: E402

BLOCK = box((0.03, 0.04, 0.03), (2, 3, 2))
MATERIAL = Material(youngs_modulus=1e5)
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
SHORT = EvaluationOptions(pickup_hold_time=0.1, platform_speed=1.0, squeeze_time=0.1, time_step=0.02)
LONG = EvaluationOptions(squeeze_time=60.0)
START_TIMEOUT = 60.0
ANSWER_TIMEOUT = 300.0


def central_grasp(id: str = "centre") -> Grasp:
    """A grasp that holds the block."""
    return Grasp(position=np.zeros(3), orientation=FROM_ABOVE, id=id)


def good_request() -> msg.EvaluationRequest:
    """A request that is fine in every respect, without log."""
    options = options_to_message(SHORT)
    options.record = False
    return msg.EvaluationRequest(
        object=object_to_message(BLOCK, MATERIAL, "block"), grasps=[grasp_to_message(central_grasp())], options=options
    )


@pytest.fixture(scope="module")
def log_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the shared evaluator writes its logs."""
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def client(log_directory: Path) -> Iterator[GraspEvaluatorClient]:
    """A client of an evaluator that runs in another process, the same for all requests."""
    with isolated_ros(), running_evaluator(log_directory), GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        yield client


def require_good_answer(client: GraspEvaluatorClient) -> None:
    """The evaluator still does its work."""
    response = client.call(good_request(), ANSWER_TIMEOUT)
    assert response.result.code == ResultCode.OK, response.result.message
    assert [evaluation.result.code for evaluation in response.evaluations] == [ResultCode.OK]


def test_good_request_is_simulated_reported_and_logged(client: GraspEvaluatorClient, log_directory: Path) -> None:
    """The block is held, the one beside it is missed; progress arrives, and the log holds the whole run."""
    grasps = [central_grasp(), Grasp(np.array([0.0, 0.2, 0.0]), FROM_ABOVE, id="beside")]
    reports: list[Progress] = []
    answer = client.evaluate_grasps(
        BLOCK,
        MATERIAL,
        grasps,
        object_name="block",
        options=SHORT,
        on_progress=reports.append,
        timeout=ANSWER_TIMEOUT,
    )
    assert answer.code == ResultCode.OK
    assert [(each.grasp_index, each.grasp_id) for each in answer.evaluations] == [(0, "centre"), (1, "beside")]
    assert [each.code for each in answer.evaluations] == [ResultCode.OK, ResultCode.NO_CONTACT]
    held = answer.evaluations[0]
    assert held.metrics.pickup_success
    assert held.metrics.max_von_mises_stress > 0.0
    weight = MATERIAL.density * BLOCK.volume * 9.81
    assert held.contacts is not None
    lift = sum(contact.forces.sum(axis=0) for contact in held.contacts)
    np.testing.assert_allclose(lift, [0.0, 0.0, weight], atol=0.02 * weight)
    assert {Phase.SQUEEZE, Phase.HOLD} <= {report.phase for report in reports}

    assert answer.log_path is not None
    assert answer.log_path.is_relative_to(log_directory)
    run = read_log(answer.log_path)
    assert run.complete
    assert run.on("request")[0].object.name == "block"
    assert [each.grasp_id for each in run.on("evaluations")].count("centre") == 1
    assert {joints.header.frame_id for joints in run.on("joint_states")} >= {"centre"}
    assert any(len(state.fingers[0].positions) for state in run.on("contacts"))
    assert {"version.warp-lang", "device", "parameters"} <= set(run.provenance)


def test_contacts_and_joints_are_published(client: GraspEvaluatorClient) -> None:
    """Whoever listens while a run goes on hears of its fingers."""
    listener = subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True)
    assert listener.stdout is not None
    assert listener.stdout.readline().strip() == "listening"
    require_good_answer(client)
    heard, _ = listener.communicate(timeout=ANSWER_TIMEOUT)
    assert heard.split() == ["contacts", "joint_states"]


LISTENER = """
import rclpy
from defgrasp_interfaces.msg import ContactState
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("listener")
heard = set()
for kind, name in ((ContactState, "contacts"), (JointState, "joint_states")):
    node.create_subscription(kind, f"/defgrasp_evaluator/{name}", lambda _, name=name: heard.add(name), 10)
while not all(node.count_publishers(f"/defgrasp_evaluator/{name}") for name in ("contacts", "joint_states")):
    rclpy.spin_once(node, timeout_sec=0.1)
print("listening", flush=True)
while len(heard) < 2:
    rclpy.spin_once(node, timeout_sec=0.1)
print(*sorted(heard))
"""


def with_material(name: str, value: float) -> Callable[[msg.EvaluationRequest], None]:
    def change(request: msg.EvaluationRequest) -> None:
        setattr(request.object.material, name, value)

    return change


def with_orientation(*orientation: float) -> Callable[[msg.EvaluationRequest], None]:
    def change(request: msg.EvaluationRequest) -> None:
        quaternion = request.grasps[0].pose.pose.orientation
        quaternion.x, quaternion.y, quaternion.z, quaternion.w = orientation

    return change


def with_data(data: bytes, format: str) -> Callable[[msg.EvaluationRequest], None]:
    def change(request: msg.EvaluationRequest) -> None:
        request.object = msg.ObjectModel(data=data, format=format)

    return change


def with_uri(uri: str) -> Callable[[msg.EvaluationRequest], None]:
    def change(request: msg.EvaluationRequest) -> None:
        request.object = msg.ObjectModel(uri=uri)

    return change


def with_open_surface(request: msg.EvaluationRequest) -> None:
    request.object = object_to_message(Surface(BLOCK.vertices, BLOCK.surface_triangles[1:]), MATERIAL)


def test_experiments_are_simulated_reported_and_logged(client: GraspEvaluatorClient) -> None:
    """The whole protocol in one call: every result is in the answer and in the log, and every phase is reported."""
    options = dataclasses.replace(
        SHORT,
        experiments=frozenset(Experiment),
        reorientation_speed=30.0,
        max_linear_acceleration=5.0,
        max_angular_acceleration=10.0,
        squeeze_sample_count=2,
        return_fields=True,
    )
    grasps = [central_grasp(), Grasp(np.array([0.0, 0.2, 0.0]), FROM_ABOVE, id="beside")]
    reports: list[Progress] = []
    answer = client.evaluate_grasps(
        BLOCK, MATERIAL, grasps, options=options, on_progress=reports.append, timeout=ANSWER_TIMEOUT
    )
    held, missed = answer.evaluations
    assert [held.code, missed.code] == [ResultCode.OK, ResultCode.NO_CONTACT]
    assert missed.reorientation is missed.linear_acceleration is missed.angular_acceleration is missed.squeeze is None
    assert held.reorientation is not None and held.squeeze is not None
    assert held.linear_acceleration is not None and held.angular_acceleration is not None
    assert held.reorientation.max_deformation.shape == (16, 4)
    assert held.metrics.deformation_controllability == held.reorientation.max_deformation.max() > 0.0
    assert len(held.reorientation.states) == 64 and len(held.squeeze.states) == 2
    assert held.linear_acceleration.is_lower_bound.all() and held.metrics.linear_instability == 5.0
    assert held.angular_acceleration.is_lower_bound.all() and held.metrics.angular_instability == 10.0
    np.testing.assert_allclose(held.squeeze.force, [7.5, 15.0])
    for force, fingers in zip(held.squeeze.force, held.squeeze.contacts, strict=True):
        closing = [abs(finger.forces.sum(axis=0)[1]) for finger in fingers]
        assert closing == pytest.approx([0.5 * force] * 2, rel=1e-3)  # it is reached to 1e-4
    assert {Phase.REORIENT, Phase.ACCELERATE, Phase.SQUEEZE_FREE} <= {report.phase for report in reports}
    assert answer.log_path is not None
    (logged,) = [each for each in read_log(answer.log_path).on("evaluations") if each.grasp_id == "centre"]
    assert len(logged.reorientation[0].states) == 64
    assert list(logged.squeeze[0].force) == [7.5, 15.0]


def test_log_alone_has_the_fields_that_nobody_asked_for(client: GraspEvaluatorClient) -> None:
    """Neither the answer nor what is published has fields over the mesh; the log has all, and its page pictures."""
    options = dataclasses.replace(
        SHORT,
        experiments=frozenset({Experiment.PICKUP, Experiment.REORIENTATION, Experiment.SQUEEZE}),
        reorientation_speed=30.0,
        squeeze_sample_count=2,
    )
    with subprocess.Popen([sys.executable, "-c", FIELD_COUNTER], stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        assert listener.stdout.readline().strip() == "listening"
        answer = client.evaluate_grasps(
            BLOCK, MATERIAL, [central_grasp("plain")], options=options, timeout=ANSWER_TIMEOUT
        )
        published, _ = listener.communicate(timeout=ANSWER_TIMEOUT)
    assert published.split() == ["0", "0", "0"]
    (held,) = answer.evaluations
    assert held.metrics.pickup_success and held.reorientation is not None and held.squeeze is not None
    assert not held.fields and not held.reorientation.states and not held.squeeze.states
    assert answer.log_path is not None
    run = load_run(answer.log_path)
    logged = run.grasps[0].evaluation
    assert list(logged.fields) == ["pre_contact", "at_target_force", "post_pickup"]
    assert logged.reorientation is not None and logged.squeeze is not None
    assert len(logged.reorientation.states) == 64 and len(logged.squeeze.states) == 2
    # Of an element, the largest of its stress points; single precision has seven digits.
    assert logged.fields["post_pickup"].von_mises_stress.max() == pytest.approx(
        held.metrics.max_von_mises_stress, rel=1e-6
    )
    page = render(run, run.grasps)
    assert "No pictures" not in page and "no fields over the mesh" not in page
    assert page.count("<image") == 6  # stress, deformation, and the four turns about one axis


FIELD_COUNTER = """
import rclpy
from defgrasp_interfaces.msg import GraspEvaluation
rclpy.init()
node = rclpy.create_node("listener")
plain = []
def take(evaluation):
    if evaluation.grasp_id == "plain":
        plain.append(evaluation)
node.create_subscription(GraspEvaluation, "/defgrasp_evaluator/evaluations", take, 10)
while not node.count_publishers("/defgrasp_evaluator/evaluations"):
    rclpy.spin_once(node, timeout_sec=0.1)
print("listening", flush=True)
while not plain:
    rclpy.spin_once(node, timeout_sec=0.1)
print(len(plain[0].fields), len(plain[0].reorientation[0].states), len(plain[0].squeeze[0].states))
"""


def without_shape(request: msg.EvaluationRequest) -> None:
    request.object = msg.ObjectModel()


def with_grasps(count: int) -> Callable[[msg.EvaluationRequest], None]:
    def change(request: msg.EvaluationRequest) -> None:
        request.grasps = request.grasps * count

    return change


def with_frame(request: msg.EvaluationRequest) -> None:
    request.grasps[0].pose.header.frame_id = "camera"


def with_hold_time(request: msg.EvaluationRequest) -> None:
    request.options.pickup_hold_time = -1.0


def with_gripper(request: msg.EvaluationRequest) -> None:
    request.gripper = "lobster"


def with_experiment(request: msg.EvaluationRequest) -> None:
    request.options.experiments = ["shake"]


BAD_REQUESTS = [
    ("unreadable mesh", with_data(b"no triangles here", "stl"), "INVALID_MESH", "object.data: "),
    ("unknown format", with_data(b"no triangles here", "exe"), "INVALID_MESH", "object.data: mesh format 'exe'"),
    ("open mesh", with_open_surface, "MESH_NOT_WATERTIGHT", "object.surface: the surface is not watertight"),
    ("no shape", without_shape, "INVALID_MESH", "give exactly one of object.uri"),
    ("unknown file", with_uri("file:///no/such/banana.stl"), "NOT_FOUND", "/no/such/banana.stl"),
    ("unknown scheme", with_uri("http://robot/banana.stl"), "INVALID_MESH", "http://robot/banana.stl"),
    ("unknown package", with_uri("package://robot/banana.stl"), "NOT_FOUND", "package 'robot'"),
    ("unknown object", with_uri("object://banana_of_gold"), "NOT_FOUND", "'banana_of_gold' is neither registered"),
    ("zero stiffness", with_material("youngs_modulus", 0.0), "INVALID_MATERIAL", "youngs_modulus = 0"),
    ("negative density", with_material("density", -1.0), "INVALID_MATERIAL", "density = -1"),
    ("friction nan", with_material("friction_coefficient", np.nan), "INVALID_MATERIAL", "friction_coefficient = nan"),
    ("incompressible", with_material("poissons_ratio", 0.5), "INVALID_MATERIAL", "poissons_ratio = 0.5"),
    ("zero quaternion", with_orientation(0.0, 0.0, 0.0, 0.0), "INVALID_GRASP", "zero quaternion"),
    ("long quaternion", with_orientation(2.0, 0.0, 0.0, 0.0), "INVALID_GRASP", "norm 2"),
    ("unknown frame", with_frame, "UNKNOWN_FRAME", "'camera'"),
    ("no grasps", with_grasps(0), "EMPTY_GRASP_LIST", "no grasps"),
    ("10 000 grasps", with_grasps(10_000), "TOO_MANY_GRASPS", "10000 grasps"),
    ("negative hold time", with_hold_time, "INVALID_OPTIONS", "pickup_hold_time = -1"),
    ("unknown experiment", with_experiment, "INVALID_OPTIONS", "'shake' is unknown; known are pickup"),
    ("unknown gripper", with_gripper, "NOT_FOUND", "'lobster'"),
]


@pytest.mark.parametrize(
    ("change", "code", "text"), [row[1:] for row in BAD_REQUESTS], ids=[row[0] for row in BAD_REQUESTS]
)
def test_bad_request_is_refused_with_its_reason(
    client: GraspEvaluatorClient, change: Callable[[msg.EvaluationRequest], None], code: str, text: str
) -> None:
    """Each fault has its code, and a text with the field and its value; nothing is evaluated or logged."""
    request = good_request()
    change(request)
    response = client.call(request, ANSWER_TIMEOUT)
    assert ResultCode(response.result.code).name == code
    assert text in response.result.message
    assert not response.evaluations
    assert not response.log_uri


def test_good_request_after_the_bad_ones_is_answered(client: GraspEvaluatorClient) -> None:
    """Nothing of the above has harmed the evaluator."""
    require_good_answer(client)


def test_one_bad_grasp_does_not_spoil_the_others(client: GraspEvaluatorClient) -> None:
    """The grasp without meaning says so in its own evaluation; each has the index and the id of the request."""
    request = good_request()
    request.grasps = [*request.grasps, msg.Grasp(id="bad"), copy.deepcopy(request.grasps[0])]
    with_orientation(*FROM_ABOVE)(request)
    request.grasps[1].pose.pose.orientation.w = 0.0
    request.grasps[2].id = ""
    response = client.call(request, ANSWER_TIMEOUT)
    assert response.result.code == ResultCode.OK
    found = [(each.grasp_index, each.grasp_id, ResultCode(each.result.code).name) for each in response.evaluations]
    assert found == [(0, "centre", "OK"), (1, "bad", "INVALID_GRASP"), (2, "", "OK")]
    assert "zero quaternion" in response.evaluations[1].result.message


def test_client_raises_the_error_of_the_code(client: GraspEvaluatorClient, tmp_path: Path) -> None:
    """What the evaluator refuses is an exception of the class that belongs to its code."""
    with pytest.raises(NotFoundError, match="missing.stl"):
        client.evaluate_grasps(MeshFile(tmp_path / "missing.stl"), MATERIAL, [central_grasp()])
    with pytest.raises(MeshNotWatertightError):
        surface = Surface(BLOCK.vertices, BLOCK.surface_triangles[1:])
        client.evaluate_grasps(surface, MATERIAL, [central_grasp()])
    with pytest.raises(InvalidMaterialError):
        client.evaluate_grasps(BLOCK, Material(density=-1.0), [central_grasp()])


def test_client_needs_no_simulator() -> None:
    """A planner's machine needs neither Warp nor a mesher to ask."""
    code = "import sys, defgrasp_ros.client; sys.exit(not {'warp', 'pytetwild'}.isdisjoint(sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_requests_at_the_same_time_wait_their_turn(client: GraspEvaluatorClient) -> None:
    """Two planners that ask at once both get their answer."""
    with GraspEvaluatorClient(node_name="second_client") as second, ThreadPoolExecutor() as threads:
        list(threads.map(require_good_answer, (client, second)))


def test_interrupted_evaluator_answers_and_closes_its_log(tmp_path: Path) -> None:
    """After SIGINT the present caller gets CANCELED, and who waits is told, too; log and exit are in order."""
    with (
        isolated_ros(),
        running_evaluator(tmp_path) as evaluator,
        GraspEvaluatorClient(node_name="first") as first,
        GraspEvaluatorClient(node_name="second") as second,
        ThreadPoolExecutor() as threads,
    ):
        waiting: list[Future] = []

        def interrupt(progress: Progress) -> None:
            if progress.phase == Phase.SQUEEZE and not waiting:
                waiting.append(threads.submit(second.call, good_request(), ANSWER_TIMEOUT))
                time.sleep(0.5)  # for the second request to arrive
                evaluator.send_signal(signal.SIGINT)

        first.wait_until_ready(START_TIMEOUT)
        second.wait_until_ready(START_TIMEOUT)
        answer = first.evaluate_grasps(
            BLOCK, MATERIAL, [central_grasp()], options=LONG, on_progress=interrupt, timeout=ANSWER_TIMEOUT
        )
        assert answer.code == ResultCode.CANCELED
        assert [each.code for each in answer.evaluations] == [ResultCode.CANCELED]
        assert answer.log_path is not None
        assert read_log(answer.log_path).complete
        try:
            assert waiting[0].result().result.code == ResultCode.CANCELED
        except EvaluatorGoneError:
            pass  # it ended before it came to the second request
        assert evaluator.wait(STOP_TIMEOUT) == 0


PLANNER = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from test_evaluator_service import BLOCK, LONG, MATERIAL, central_grasp
from defgrasp_ros.client import GraspEvaluatorClient
with GraspEvaluatorClient() as client:
    client.wait_until_ready(60.0)
    client.evaluate_grasps(BLOCK, MATERIAL, [central_grasp()], options=LONG)
"""


def test_killed_evaluator_leaves_a_readable_log(tmp_path: Path) -> None:
    """After SIGKILL in the middle of a run, what was written can be read: the request and every topic so far."""
    with isolated_ros(), running_evaluator(tmp_path) as evaluator:
        planner = subprocess.Popen([sys.executable, "-c", PLANNER, Path(__file__).parent])
        try:
            wait_for(lambda: any(len(read_log(path).on("contacts")) > 20 for path in tmp_path.glob("*/*.mcap")))
            evaluator.kill()
            evaluator.wait()
        finally:
            planner.kill()
            planner.wait()
    (path,) = tmp_path.glob("*/*.mcap")
    run = read_log(path)
    assert not run.complete
    assert len(run.on("request")) == 1
    assert len(run.on("contacts")) > 20
    assert len(run.on("all_joint_states")) == pytest.approx(len(run.on("contacts")), abs=1)
    assert run.on("status")


def wait_for(condition: Callable[[], bool]) -> None:
    """Return as soon as the condition holds."""
    deadline = time.monotonic() + ANSWER_TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.2)
