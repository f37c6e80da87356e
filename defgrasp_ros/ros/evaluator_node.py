"""The node ``defgrasp_evaluator``: a managed node that answers requests to evaluate grasps, one after the other."""

from __future__ import annotations

import argparse
import atexit
import signal
import sys
import traceback
from collections.abc import Sequence
from threading import Event, Thread

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from defgrasp_ros.errors import IncorrectStateError, ResourceExhaustedError, ResultCode
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.ros.diagnostics import Diagnostics
from defgrasp_ros.ros.evaluation_action import ACTION_NAME, EvaluationAction
from defgrasp_ros.ros.evaluation_queue import EvaluationQueue
from defgrasp_ros.ros.evaluation_service import SERVICE_NAME, EvaluationService
from defgrasp_ros.ros.evaluator import Evaluator, give_up
from defgrasp_ros.ros.evaluator_info import EvaluatorInfo
from defgrasp_ros.ros.executor import PatientExecutor
from defgrasp_ros.ros.managed_node import ManagedNode
from defgrasp_ros.ros.object_registry import ObjectRegistry
from defgrasp_ros.ros.object_services import ObjectServices
from defgrasp_ros.ros.open_answers import OpenAnswers
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.parameters import declare_parameters
from defgrasp_ros.ros.robot_description import send_robot_description
from defgrasp_ros.ros.status_reporter import StatusReporter

NODE_NAME = "defgrasp_evaluator"

EXECUTOR_THREADS = 4
"""One may wait for a transition, one for the mesher; the others keep everything else alive."""


class EvaluatorNode(ManagedNode):
    """Evaluates candidate grasps on request.

    Configured, it has checked device and gripper, and its kernels are compiled; active, it does what the queue holds.
    With the parameter ``autostart`` it becomes active by itself, and requests that come before wait for that.
    The simulation has a thread of its own, and no callback waits for it, so that the node stays responsive.
    """

    def __init__(self) -> None:
        super().__init__(NODE_NAME)
        declare_parameters(self)
        self._devices: list[str] = []
        self._takes_requests: bool = self.get_parameter("autostart").value
        self._registry = ObjectRegistry()
        self._outputs = Outputs(self)
        self._status = StatusReporter(self, self._outputs, lambda: self._queue.waiting_count)
        self._evaluator = Evaluator(self, self._outputs, self._status, self._registry)
        self._queue = EvaluationQueue(self._evaluator.answer, give_up)
        self.open_answers = OpenAnswers(self)
        """Answers that are still to be sent."""
        EvaluationService(self, self._queue, self._require_room, self.open_answers)
        EvaluationAction(self, self._queue, self._status, self._require_room, self.open_answers)
        EvaluatorInfo(self, self._status, self._registry, lambda: self._devices)
        self._object_services = ObjectServices(self, self._registry)
        Diagnostics(
            self,
            self._outputs,
            self._device_problem,
            lambda: self._queue.waiting_count,
            lambda: self._evaluator.last_failure,
        )
        self.create_service(Trigger, "~/stop", self._stop, callback_group=MutuallyExclusiveCallbackGroup())
        self._evaluator.rest()
        if self._takes_requests:
            self.start_by_itself()

    def stop(self) -> None:
        """End every request, and take no more; the callers get what is finished, the rest CANCELED."""
        self._takes_requests = False
        self._object_services.stop()
        self._queue.close()

    def configure(self) -> None:
        """Check gripper and device, and compile the kernels."""
        from defgrasp_ros.simulation.simulator import device_names, prepare_device  # loads the simulator

        self._devices = device_names()
        gripper = load_gripper(self.get_parameter("gripper").value)
        send_robot_description(self._outputs, gripper, self.get_clock().now().nanoseconds)
        prepare_device(self.get_parameter("device").value)

    def activate(self) -> None:
        """Take requests."""
        self._takes_requests = self._evaluator.is_active = True
        self._evaluator.rest()
        self._queue.resume()
        self.get_logger().info(
            f"ready: {self.resolve_service_name(SERVICE_NAME)}, {self.resolve_service_name(ACTION_NAME)}"
        )

    def deactivate(self, reason: str) -> None:
        """Take no more requests; those that are there end, and their callers get what is finished."""
        self._takes_requests = self._evaluator.is_active = False
        self._queue.pause()
        if not self._queue.end_all(ResultCode.CANCELED, reason):
            self._evaluator.rest()

    def cleanup(self) -> None:
        """Forget the registered objects."""
        self._registry.clear()

    def _device_problem(self) -> str | None:
        """Return why the device cannot be used; empty where it can, None before the configuration."""
        device = self.get_parameter("device").value
        if self.problem == "" and device not in self._devices:
            return f"device = '{device}' is not available; this machine has: {', '.join(self._devices)}"
        return self.problem

    def _require_room(self) -> None:
        """Raise where no request can be taken now."""
        if not self._takes_requests:
            why = self.problem or "activate it with its lifecycle services"
            raise IncorrectStateError(f"the evaluator is not active: {why}")
        most = self.get_parameter("max_queued_goals").value
        if self._queue.is_full(most):
            raise ResourceExhaustedError(f"max_queued_goals = {most} requests wait already; ask again later")

    def _stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._queue.end_running(ResultCode.CANCELED, "stopped by ~/stop")
        response.message = "the evaluation ends" if response.success else "nothing is being evaluated"
        return response


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node until SIGINT or SIGTERM; a running evaluation then ends early, is answered and its log closed."""
    parser = argparse.ArgumentParser(
        prog=NODE_NAME,
        description="ROS 2 node that evaluates grasps of deformable objects.",
        epilog="ROS arguments come after --ros-args: -p device:=cuda:0, --params-file evaluator.yaml, -r __ns:=/arm, "
        "--log-level debug. 'python -m defgrasp_ros.ros.parameters' prints a parameter file with every default.",
    )
    parser.parse_args(remove_ros_args(arguments)[1:])
    ended = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = EvaluatorNode()
    except (InvalidParameterValueException, InvalidParameterTypeException) as error:
        sys.exit(f"defgrasp_evaluator: {error}")
    executor = PatientExecutor(num_threads=EXECUTOR_THREADS)
    executor.add_node(node)

    def spin() -> None:
        while rclpy.ok() and not ended.is_set():
            try:
                executor.spin()
            except Exception:  # of one callback; the others go on
                node.get_logger().error(traceback.format_exc())
        ended.set()

    spinner = Thread(target=spin, name="executor")
    spinner.start()
    ended.wait()
    node.stop()
    node.open_answers.flush(executor)
    executor.shutdown()
    spinner.join()
    # The executor's own threads may still be sending the last answer; Python joins them before exit handlers run.
    atexit.register(rclpy.try_shutdown)


if __name__ == "__main__":
    main()
