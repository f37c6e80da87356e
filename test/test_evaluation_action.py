"""The action of the evaluator, from another process: goals that wait, report, are canceled, and run out of time."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from ros_processes import isolated_ros, running_evaluator

from defgrasp_ros.errors import IncorrectStateError, NotFoundError, ResourceExhaustedError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box, kidney_surface

pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from defgrasp_ros.client import (  # noqa: E402
    EvaluationGoal,
    EvaluationProgress,
    EvaluatorGoneError,
    GraspEvaluatorClient,
    Surface,
)
from defgrasp_ros.recording import read_log  # noqa: E402

pytestmark = pytest.mark.timeout(300)  # the first one compiles the kernels

BLOCK = box((0.03, 0.04, 0.03), (2, 3, 2))
MATERIAL = Material(youngs_modulus=1e5)
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
SHORT = EvaluationOptions(pickup_hold_time=0.1, platform_speed=1.0, squeeze_time=0.1, time_step=0.02)
LONG = EvaluationOptions(squeeze_time=60.0, time_step=1e-3)
START_TIMEOUT = 60.0
TIMEOUT = 250.0

CENTRE = Grasp(np.zeros(3), FROM_ABOVE, id="centre")
BESIDE = Grasp(np.array([0.0, 0.2, 0.0]), FROM_ABOVE, id="beside")


@pytest.fixture(scope="module")
def evaluator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen]:
    """An evaluator with room for one goal that waits."""
    with isolated_ros(), running_evaluator(tmp_path_factory.mktemp("logs"), max_queued_goals=1) as process:
        yield process


@pytest.fixture
def client(evaluator: subprocess.Popen) -> Iterator[GraspEvaluatorClient]:
    with GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        yield client


def long_goal(client: GraspEvaluatorClient, grasps: tuple[Grasp, ...] = (CENTRE,), **more: object) -> EvaluationGoal:
    """Start a goal that takes longer than any test, and return when it is being simulated."""
    begun = Event()

    def follow(progress: EvaluationProgress) -> None:
        if progress.object_name == "long" and progress.fraction > 0.0:
            begun.set()

    goal = client.start_evaluation(
        BLOCK, MATERIAL, grasps, object_name="long", options=LONG, on_progress=follow, **more
    )
    assert begun.wait(TIMEOUT)
    return goal


def require_good_answer(client: GraspEvaluatorClient) -> None:
    """The evaluator still does its work."""
    answer = client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE], options=SHORT, record=False, timeout=TIMEOUT)
    assert [each.code for each in answer.evaluations] == [ResultCode.OK]


def test_goal_reports_progress_and_evaluations(client: GraspEvaluatorClient) -> None:
    """Every evaluation comes with the feedback, once; the progress grows, and the remaining time is known at last."""
    reports: list[EvaluationProgress] = []
    evaluations: list[GraspEvaluation] = []
    answer = client.evaluate_grasps(
        BLOCK,
        MATERIAL,
        [BESIDE, CENTRE],
        options=EvaluationOptions(pickup_hold_time=0.3, platform_speed=1.0, time_step=0.01),
        on_progress=reports.append,
        on_evaluation=evaluations.append,
        timeout=TIMEOUT,
    )
    assert answer.code == ResultCode.OK
    assert [each.grasp_id for each in answer.evaluations] == ["beside", "centre"]
    assert [each.grasp_id for each in evaluations] == ["beside", "centre"]
    stress = answer.evaluations[1].metrics.max_von_mises_stress
    assert evaluations[1].metrics.max_von_mises_stress == stress > 0.0
    run = [report for report in reports if report.run_id]
    assert len({report.run_id for report in run}) == 1
    fractions = [report.fraction for report in run]
    assert fractions == sorted(fractions) and 0.0 < fractions[-1] <= 1.0
    assert [report.finished_grasps for report in run][-1] == 2
    known = [report.time_remaining for report in run if not math.isnan(report.time_remaining)]
    assert known and min(known) >= 0.0


def test_canceled_goal_returns_what_is_finished(client: GraspEvaluatorClient) -> None:
    """The grasp that missed keeps its verdict, the other is CANCELED, in the log as well; the next goal is served."""
    missed = Event()
    goal = long_goal(client, (CENTRE, BESIDE), on_evaluation=lambda _: missed.set())
    assert missed.wait(TIMEOUT)
    goal.cancel()
    answer = goal.answer(TIMEOUT)
    assert answer.code == ResultCode.CANCELED
    assert [each.code for each in answer.evaluations] == [ResultCode.CANCELED, ResultCode.NO_CONTACT]
    assert "canceled by the caller" in answer.evaluations[0].message
    assert answer.log_path is not None
    logged = {each.grasp_id: each.result.code for each in read_log(answer.log_path).on("evaluations")}
    assert logged == {"centre": ResultCode.CANCELED, "beside": ResultCode.NO_CONTACT}
    require_good_answer(client)


def test_goal_that_waits_can_be_canceled(client: GraspEvaluatorClient) -> None:
    """It is answered at once, and the running one goes on; a further one finds no room meanwhile."""
    running = long_goal(client)
    waiting = client.start_evaluation(BLOCK, MATERIAL, [CENTRE, BESIDE], options=SHORT)
    assert client.info(TIMEOUT).queued_goals == 1
    with pytest.raises(ResourceExhaustedError, match="max_queued_goals = 1"):
        client.start_evaluation(BLOCK, MATERIAL, [CENTRE])
    waiting.cancel()
    answer = waiting.answer(TIMEOUT)
    assert answer.code == ResultCode.CANCELED
    assert [each.code for each in answer.evaluations] == [ResultCode.CANCELED] * 2
    assert "before its turn" in answer.message
    assert not running.done
    assert client.info(TIMEOUT).queued_goals == 0
    running.cancel()
    assert running.answer(TIMEOUT).code == ResultCode.CANCELED


def test_time_limit_leaves_what_is_finished(client: GraspEvaluatorClient) -> None:
    """What is not finished when the time is up comes back as TIMEOUT, with the limit in the text."""
    answer = client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE, BESIDE], options=LONG, time_limit=2.0, timeout=TIMEOUT)
    assert answer.code == ResultCode.TIMEOUT
    assert [each.code for each in answer.evaluations] == [ResultCode.TIMEOUT, ResultCode.NO_CONTACT]
    assert "time limit of 2 s" in answer.evaluations[0].message


def test_time_limit_that_is_over_at_once_answers_every_grasp(client: GraspEvaluatorClient) -> None:
    """It counts from the beginning, and each grasp says how far the run was."""
    answer = client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE, BESIDE], time_limit=1e-3, timeout=TIMEOUT)
    assert [each.code for each in answer.evaluations] == [ResultCode.TIMEOUT] * 2
    assert answer.code == ResultCode.TIMEOUT and "time limit of 0.001 s" in answer.message
    text = "ended before the object had come to rest: stopped at the time limit of 0.001 s"
    assert {each.message for each in answer.evaluations} == {text}


def test_time_limit_ends_the_mesher(client: GraspEvaluatorClient) -> None:
    """A surface that takes long to fill with tetrahedra does not outlast the limit."""
    vertices, triangles = kidney_surface()
    source = Surface(vertices, triangles, target_edge_length=0.005)
    answer = client.evaluate_grasps(source, MATERIAL, [CENTRE], time_limit=0.5, timeout=TIMEOUT)
    assert [each.code for each in answer.evaluations] == [ResultCode.TIMEOUT]


def test_stop_ends_the_running_goal(client: GraspEvaluatorClient) -> None:
    """Whoever calls ``~/stop`` ends it; its caller gets what is finished. Without a goal there is nothing to stop."""
    goal = long_goal(client)
    assert client.stop(TIMEOUT)
    answer = goal.answer(TIMEOUT)
    assert answer.code == ResultCode.CANCELED and "~/stop" in answer.message
    assert not client.stop(TIMEOUT)


def test_service_and_action_share_the_queue(client: GraspEvaluatorClient) -> None:
    """A request to the service waits behind a goal, and is refused where there is no room."""
    from test_evaluator_service import good_request

    goal = long_goal(client)
    with ThreadPoolExecutor() as threads:
        waiting = threads.submit(client.call, good_request(), TIMEOUT)
        while not client.info(TIMEOUT).queued_goals:
            assert not waiting.done()
        assert client.call(good_request(), TIMEOUT).result.code == ResultCode.RESOURCE_EXHAUSTED
        goal.cancel()
        assert waiting.result().result.code == ResultCode.OK


def test_bad_request_is_an_error_of_its_class(client: GraspEvaluatorClient) -> None:
    """What is refused as a whole raises; a negative time limit is refused, too."""
    with pytest.raises(NotFoundError, match="lobster"):
        client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE], gripper="lobster", timeout=TIMEOUT)
    with pytest.raises(Exception, match="time_limit = -1"):
        client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE], time_limit=-1.0, timeout=TIMEOUT)


def test_client_that_gives_up_cancels_its_goal(client: GraspEvaluatorClient) -> None:
    """After the client's own timeout the evaluator is free again."""
    with pytest.raises(TimeoutError):
        client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE], options=LONG, timeout=2.0)
    require_good_answer(client)


def test_description_while_a_goal_runs(client: GraspEvaluatorClient) -> None:
    """It says what the evaluator is and does, with names that requests can use."""
    goal = long_goal(client)
    info = client.info(TIMEOUT)
    assert info.device == "cpu" and "cpu" in info.devices
    assert {"pickup", "squeeze"} <= set(info.experiments)
    assert "stl" in info.mesh_formats and "franka_hand" in info.grippers and "paper" in info.presets
    assert (info.max_queued_goals, info.queued_goals) == (1, 0)
    assert info.status.object_name == "long" and info.status.real_time_factor > 0.0
    goal.cancel()
    goal.answer(TIMEOUT)
    assert math.isnan(client.info(TIMEOUT).status.real_time_factor)


PLANNER = """
import sys
sys.path.insert(0, sys.argv[1])
from test_evaluation_action import BLOCK, CENTRE, LONG, MATERIAL
from defgrasp_ros.client import GraspEvaluatorClient
with GraspEvaluatorClient(node_name="doomed") as client:
    client.wait_until_ready(60.0)
    client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE], object_name="doomed", options=LONG, on_progress=lambda p: print(
        p.object_name, flush=True))
"""


def test_killed_client_does_not_block_the_next(evaluator: subprocess.Popen) -> None:
    """When the only client dies in the middle of its goal, the goal ends, and who comes later is served."""
    planner = subprocess.Popen(
        [sys.executable, "-c", PLANNER, Path(__file__).parent], stdout=subprocess.PIPE, text=True
    )
    assert planner.stdout is not None
    for line in planner.stdout:
        if line.strip() == "doomed":
            break
    planner.kill()
    planner.wait()
    with GraspEvaluatorClient(node_name="heir") as client:
        client.wait_until_ready(START_TIMEOUT)
        client.stop(TIMEOUT)  # the dead one's discovery ends only after a while
        require_good_answer(client)


def test_killed_evaluator_is_noticed_and_its_successor_serves(tmp_path: Path) -> None:
    """A client whose evaluator dies is told; the same client is served by the next evaluator."""
    with isolated_ros(), GraspEvaluatorClient() as client:
        with running_evaluator(tmp_path) as first:
            client.wait_until_ready(START_TIMEOUT)
            goal = long_goal(client)
            first.send_signal(signal.SIGKILL)
            with pytest.raises(EvaluatorGoneError):
                goal.answer(TIMEOUT)
        with running_evaluator(tmp_path):
            client.wait_until_ready(START_TIMEOUT)
            require_good_answer(client)


def test_inactive_evaluator_takes_nothing(tmp_path: Path) -> None:
    """Without autostart, goals are rejected and requests refused until it is activated."""
    from test_evaluator_service import good_request

    with isolated_ros(), running_evaluator(tmp_path, autostart=False), GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        with pytest.raises(IncorrectStateError, match="not active"):
            client.start_evaluation(BLOCK, MATERIAL, [CENTRE])
        assert client.call(good_request(), TIMEOUT).result.code == ResultCode.INCORRECT_STATE
