"""The evaluator's answers when simulation or log fail, with a stand-in for the simulation."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from ros_processes import isolated_ros

from defgrasp_ros.errors import DefgraspError, ResultCode, SolverDivergedError
from defgrasp_ros.evaluation import EvaluationObserver, EvaluationOptions, GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.stop_signal import StopSignal

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from defgrasp_interfaces.msg import EvaluatorStatus  # noqa: E402
from rclpy.executors import MultiThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from defgrasp_ros.client import EvaluationAnswer, GraspEvaluatorClient  # noqa: E402
from defgrasp_ros.recording import read_log  # noqa: E402
from defgrasp_ros.ros.evaluator_node import EvaluatorNode  # noqa: E402

BLOCK = box((0.04, 0.04, 0.04), (1, 1, 1))


def held(
    object_model: ObjectModel,
    grasps: list[Grasp],
    gripper: Gripper,
    options: EvaluationOptions,
    device: str,
    observer: EvaluationObserver,
    stop: StopSignal,
) -> list[GraspEvaluation]:
    """Stand-in for the simulation: every grasp holds for as long as it should."""
    evaluations = [
        GraspEvaluation(index, grasp.id, holding_time=options.pickup_hold_time) for index, grasp in enumerate(grasps)
    ]
    for evaluation in evaluations:
        observer.on_evaluation(evaluation)
    return evaluations


@pytest.fixture
def node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[EvaluatorNode]:
    """A spinning evaluator in this process, alone on its domain, that simulates nothing."""
    monkeypatch.setattr("defgrasp_ros.experiments.evaluate_grasps", held)
    monkeypatch.setattr("defgrasp_ros.simulation.simulator.prepare_device", lambda name: None)
    with isolated_ros():
        rclpy.init()
        node = EvaluatorNode()
        executor = MultiThreadedExecutor(num_threads=3)
        executor.add_node(node)
        spinner = Thread(target=executor.spin)
        spinner.start()
        set_parameter(node, "record.directory", str(tmp_path / "logs"))
        with GraspEvaluatorClient() as client:
            while client.info(60.0).status.state == EvaluatorStatus.STATE_INACTIVE:
                pass
        yield node
        node.stop()
        executor.shutdown()
        spinner.join()
        node.destroy_node()
        rclpy.shutdown()


def set_parameter(node: EvaluatorNode, name: str, value: object) -> None:
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert result.successful, result.reason


def ask(**changes: object) -> EvaluationAnswer:
    """Ask for one grasp."""
    grasp = Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), id="centre")
    with GraspEvaluatorClient() as client:
        return client.evaluate_grasps(BLOCK, Material(), [grasp], timeout=60.0, **changes)


def failing_with(error: Exception) -> object:
    def evaluate_grasps(*_: object) -> list[GraspEvaluation]:
        raise error

    return evaluate_grasps


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (SolverDivergedError("step 3 has no solution"), ResultCode.SOLVER_DIVERGED, "step 3 has no solution"),
        (RuntimeError("bug"), ResultCode.OPERATION_FAILED, "RuntimeError: bug"),
        (MemoryError(), ResultCode.RESOURCE_EXHAUSTED, "memory"),
    ],
)
def test_failing_simulation_is_an_answer(
    node: EvaluatorNode, monkeypatch: pytest.MonkeyPatch, error: Exception, code: ResultCode, text: str, tmp_path: Path
) -> None:
    """What the simulation raises comes back as code and text; the log is closed, the next request answered."""
    with monkeypatch.context() as patch:
        patch.setattr("defgrasp_ros.experiments.evaluate_grasps", failing_with(error))
        with pytest.raises(DefgraspError, match=text) as caught:
            ask()
        assert caught.value.code == code
    (log,) = tmp_path.glob("logs/*/*.mcap")
    assert caught.value.__notes__ == [f"what happened before is in the log {log}"]
    assert read_log(log).complete
    assert ask().code == ResultCode.OK


def failing_after(done: int, error: Exception) -> object:
    def evaluate_grasps(object_model, grasps, gripper, options, device, observer, stop) -> list[GraspEvaluation]:
        held(object_model, grasps[:done], gripper, options, device, observer, stop)
        raise error

    return evaluate_grasps


def test_failure_in_the_middle_leaves_what_is_finished(node: EvaluatorNode, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first grasp keeps its evaluation, the second has the code of the failure, and so has the goal."""
    error = SolverDivergedError("step 3 has no solution")
    monkeypatch.setattr("defgrasp_ros.experiments.evaluate_grasps", failing_after(1, error))
    grasps = [Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), id=id) for id in ("first", "second")]
    with GraspEvaluatorClient() as client:
        answer = client.evaluate_grasps(BLOCK, Material(), grasps, timeout=60.0)
    assert answer.code == ResultCode.SOLVER_DIVERGED
    found = [(each.grasp_id, each.code) for each in answer.evaluations]
    assert found == [("first", ResultCode.OK), ("second", ResultCode.SOLVER_DIVERGED)]
    assert "step 3 has no solution" in answer.evaluations[1].message and "step 3" in answer.message


def test_error_of_the_callers_function_is_the_callers(node: EvaluatorNode) -> None:
    """What ``on_evaluation`` raises comes out of the call, and the client goes on working."""

    def complain(_: GraspEvaluation) -> None:
        raise KeyError("mine")

    grasp = Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    with GraspEvaluatorClient() as client:
        with pytest.raises(KeyError, match="mine"):
            client.evaluate_grasps(BLOCK, Material(), [grasp], on_evaluation=complain, timeout=60.0)
        assert client.evaluate_grasps(BLOCK, Material(), [grasp], timeout=60.0).code == ResultCode.OK


def test_log_that_cannot_be_written_does_not_stop_the_evaluation(node: EvaluatorNode, tmp_path: Path) -> None:
    """The grasp is evaluated, and the text says why there is no log; the next run is logged again."""
    (tmp_path / "file").touch()
    set_parameter(node, "record.directory", str(tmp_path / "file"))
    answer = ask()
    assert answer.code == ResultCode.OK
    assert answer.log_path is None
    assert "not logged: cannot make the log" in answer.message
    set_parameter(node, "record.directory", str(tmp_path / "logs"))
    answer = ask()
    assert answer.log_path is not None
    assert "not logged" not in answer.message


def test_log_that_reaches_its_size_ends_and_the_evaluation_goes_on(node: EvaluatorNode, tmp_path: Path) -> None:
    """The grasp is evaluated, the text tells the limit, and what is in the log can be read."""
    set_parameter(node, "record.max_size", 0.3)
    answer = ask(object_name=os.urandom(300_000).hex())
    assert answer.code == ResultCode.OK
    assert "the log is not complete" in answer.message
    assert "largest size, 0.3 MB" in answer.message
    (log,) = tmp_path.glob("logs/*/*.mcap")
    assert log.stat().st_size <= 300_000
    assert read_log(log).complete
    set_parameter(node, "record.max_size", 0.0)
    assert "not complete" not in ask().message


def test_only_the_topics_asked_for_are_logged(node: EvaluatorNode, tmp_path: Path) -> None:
    """A log holds the named topics and the request; a name that no topic has is refused."""
    set_parameter(node, "record.topics", "evaluations, ~/status")
    answer = ask()
    assert answer.log_path is not None
    names = {entry.topic.rpartition("/")[2] for entry in read_log(answer.log_path).messages}
    assert names == {"request", "evaluations", "status"}
    (result,) = node.set_parameters([Parameter("record.topics", value="evaluation")])
    assert not result.successful
    assert "no topic 'evaluation'" in result.reason


def test_log_can_be_switched_off(node: EvaluatorNode, tmp_path: Path) -> None:
    """Neither a request that asks for no log nor a node that writes none leaves a file."""
    assert ask(record=False).log_path is None
    set_parameter(node, "record.enabled", False)
    assert ask().log_path is None
    assert not (tmp_path / "logs").exists()


def test_options_left_out_are_the_parameters(node: EvaluatorNode) -> None:
    """A number of the request counts; where there is none, the parameter does."""
    set_parameter(node, "experiment.pickup_hold_time", 2.5)
    assert ask().evaluations[0].holding_time == 2.5
    assert ask(options=EvaluationOptions(pickup_hold_time=0.5)).evaluations[0].holding_time == 0.5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gripper", "lobster"),
        ("device", "tpu"),
        ("experiment.time_step", -1.0),
        ("max_grasps", 0),
        ("publish.sample_rate", 1e9),
    ],
)
def test_impossible_parameter_is_refused(node: EvaluatorNode, name: str, value: object) -> None:
    """A value outside its range is not taken, and the reason is told."""
    before = node.get_parameter(name).value
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert result.reason
    assert node.get_parameter(name).value == before
