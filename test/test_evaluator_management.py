"""What the official tools use of the evaluator: lifecycle and parameter services, diagnostics."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ros_processes import isolated_ros, running_evaluator
from test_evaluation_action import BLOCK, CENTRE, MATERIAL, START_TIMEOUT, TIMEOUT, long_goal, require_good_answer

from defgrasp_ros.errors import IncorrectStateError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from lifecycle_msgs.msg import State, Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState  # noqa: E402
from rcl_interfaces.msg import ParameterDescriptor  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from defgrasp_ros.client import DEFAULT_EVALUATOR, GraspEvaluatorClient, RegisteredObject  # noqa: E402
from defgrasp_ros.ros.parameters import PARAMETERS  # noqa: E402

pytestmark = pytest.mark.timeout(300)  # the first one compiles the kernels


class Operator:
    """Somebody with the official tools, who knows nothing of this package."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("operator", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def call(self, kind: type, name: str, request: object) -> Any:
        client = self.node.create_client(kind, f"{DEFAULT_EVALUATOR}/{name}")
        assert client.wait_for_service(START_TIMEOUT)
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, TIMEOUT)
        self.node.destroy_client(client)
        assert future.done()
        return future.result()

    def change_state(self, label: str) -> bool:
        """Ask for a transition as the official command does: as one of those that are offered."""
        request = GetAvailableTransitions.Request()
        offered = self.call(GetAvailableTransitions, "get_available_transitions", request).available_transitions
        (chosen,) = [each.transition for each in offered if each.transition.label == label]
        return self.call(ChangeState, "change_state", ChangeState.Request(transition=chosen)).success

    def insist_on(self, transition: int) -> bool:
        """Ask for a transition whether it is offered or not."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "change_state", request).success

    def state(self) -> int:
        return self.call(GetState, "get_state", GetState.Request()).current_state.id

    def set_parameter(self, name: str, value: object) -> str:
        """Set a parameter; return why it was refused."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self.call(SetParameters, "set_parameters", request).results
        assert result.successful or result.reason
        return result.reason

    def wait_until(self, condition: Any) -> None:
        """Spin until something holds; the test's own time limit ends it otherwise."""
        while not condition():
            self.executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def operator() -> Iterator[Operator]:
    with isolated_ros():
        operator = Operator()
        yield operator
        operator.close()


def test_life_of_the_evaluator(operator: Operator, tmp_path: Path) -> None:
    """Configured, activated, deactivated in the middle of a goal, cleaned up, started again, and shut down."""
    with running_evaluator(tmp_path, autostart=False) as process, GraspEvaluatorClient() as client:
        assert operator.state() == State.PRIMARY_STATE_UNCONFIGURED
        assert not operator.insist_on(Transition.TRANSITION_ACTIVATE)  # not from here
        assert operator.change_state("configure")
        assert operator.state() == State.PRIMARY_STATE_INACTIVE
        with pytest.raises(IncorrectStateError, match="not active"):
            client.start_evaluation(BLOCK, MATERIAL, [CENTRE])
        assert operator.change_state("activate")
        require_good_answer(client)

        client.register_object(BLOCK, MATERIAL, "block", timeout=TIMEOUT)
        goal = long_goal(client)
        waiting = client.start_evaluation(RegisteredObject("block"), MATERIAL, [CENTRE])
        assert operator.change_state("deactivate")
        for each in (goal, waiting):
            answer = each.answer(TIMEOUT)
            assert answer.code == ResultCode.CANCELED and "deactivated" in answer.message
        assert operator.change_state("cleanup")
        assert list(client.list_objects(TIMEOUT).object_ids) == []

        assert operator.set_parameter("device", "cuda:77") == ""
        assert not operator.change_state("configure")
        assert operator.state() == State.PRIMARY_STATE_UNCONFIGURED
        operator.set_parameter("device", "cpu")
        assert operator.change_state("configure")
        assert operator.change_state("activate")
        require_good_answer(client)
        assert operator.change_state("shutdown")
        assert operator.state() == State.PRIMARY_STATE_FINALIZED
        assert process.poll() is None


def test_every_parameter_describes_itself(operator: Operator, tmp_path: Path) -> None:
    """Each has a description, a range where it is a number, and the default of the table."""
    with running_evaluator(tmp_path):
        names = [parameter.name for parameter in PARAMETERS]
        listed = operator.call(ListParameters, "list_parameters", ListParameters.Request()).result.names
        assert set(names) <= set(listed)
        described = operator.call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names))
        descriptors: dict[str, ParameterDescriptor] = {each.name: each for each in described.descriptors}
        for parameter in PARAMETERS:
            descriptor = descriptors[parameter.name]
            assert parameter.description in descriptor.description
            assert descriptor.read_only == parameter.read_only
            if isinstance(parameter.default, int | float) and not isinstance(parameter.default, bool):
                assert descriptor.floating_point_range or descriptor.integer_range, parameter.name
                assert parameter.unit or isinstance(parameter.default, int), parameter.name
        assert "read-only" in operator.set_parameter("preset", "defgraspsim_code")
        assert operator.set_parameter("experiment.time_step", 1.0)
        assert "force_safety_factor" in operator.set_parameter("experiment.force_safety_factor", 0.0)
        assert operator.set_parameter("experiment.reorientation_settles", False) == ""


def test_preset_is_where_the_constants_come_from(operator: Operator, tmp_path: Path) -> None:
    """What the preset names has its value, but for a parameter that is given."""
    given = {"preset": "defgraspsim_code", "experiment.pickup_hold_time": 0.5}
    with running_evaluator(tmp_path, **given):
        names = [
            f"experiment.{name}"
            for name in ("linear_jerk", "reorientation_settles", "pickup_hold_time", "squeeze_time")
        ]
        values = operator.call(GetParameters, "get_parameters", GetParameters.Request(names=names)).values
        jerk, settles, hold, squeeze = values
        assert (jerk.double_value, settles.bool_value, hold.double_value) == (100.0, False, 0.5)
        assert squeeze.double_value == EvaluationOptions().squeeze_time


def test_impossible_parameter_file_ends_the_node_with_its_reason(operator: Operator, tmp_path: Path) -> None:
    """The exit status is not 0, and the output names parameter and value."""
    with running_evaluator(tmp_path, preset="papper") as process:
        assert process.wait(START_TIMEOUT) != 0
    assert "preset 'papper' is unknown" in (tmp_path / "evaluator.txt").read_text()


def test_help_of_the_node() -> None:
    """It says how to give parameters, and starts nothing; what it does not know is refused."""
    command = [sys.executable, "-m", "defgrasp_ros.ros.evaluator_node"]
    asked = subprocess.run([*command, "--help"], capture_output=True, text=True)
    assert asked.returncode == 0 and "--params-file" in asked.stdout
    assert subprocess.run([*command, "--device", "cpu"], capture_output=True).returncode == 2


def test_diagnostics_tell_how_each_part_is(operator: Operator, tmp_path: Path) -> None:
    """Each part has a status: a run that fails is a warning until the next, a folder that is none is an error."""
    heard: list[dict[str, DiagnosticStatus]] = []
    operator.node.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda message: heard.append({each.name.split(": ")[1]: each for each in message.status}),
        10,
    )
    with running_evaluator(tmp_path), GraspEvaluatorClient() as client:
        require_good_answer_after_start(client)
        operator.wait_until(lambda: heard and heard[-1]["device"].level == DiagnosticStatus.OK)
        parts = heard[-1]
        assert {"device", "queue", "last run", "recording", "logs", "kernel cache"} <= set(parts)
        assert parts["device"].hardware_id == "cpu"
        assert parts["last run"].level == DiagnosticStatus.OK
        with pytest.raises(Exception, match="lobster"):
            client.evaluate_grasps(BLOCK, MATERIAL, [CENTRE], gripper="lobster", timeout=TIMEOUT)
        operator.wait_until(lambda: heard[-1]["last run"].level == DiagnosticStatus.WARN)
        assert "lobster" in heard[-1]["last run"].message
        require_good_answer(client)
        operator.wait_until(lambda: heard[-1]["last run"].level == DiagnosticStatus.OK)
        assert heard[-1]["logs"].level == DiagnosticStatus.OK
        assert operator.set_parameter("record.directory", str(tmp_path / "evaluator.txt" / "logs")) == ""
        operator.wait_until(lambda: heard[-1]["logs"].level == DiagnosticStatus.ERROR)


def require_good_answer_after_start(client: GraspEvaluatorClient) -> None:
    client.wait_until_ready(START_TIMEOUT)
    require_good_answer(client)
