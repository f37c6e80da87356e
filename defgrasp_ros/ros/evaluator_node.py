"""The node ``defgrasp_evaluator``: answers requests to evaluate grasps, one after the other."""

from __future__ import annotations

import atexit
import signal
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Thread

import rclpy
from defgrasp_interfaces.msg import EvaluationRequest, Result
from defgrasp_interfaces.srv import EvaluateGrasp
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from defgrasp_ros.errors import DefgraspError, ResultCode
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.ros.evaluation_run import EvaluationRun
from defgrasp_ros.ros.object_registry import ObjectRegistry
from defgrasp_ros.ros.object_services import ObjectServices
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.parameters import declare_parameters, parameter_values
from defgrasp_ros.ros.robot_description import send_robot_description
from defgrasp_ros.ros.status_reporter import StatusReporter

NODE_NAME = "defgrasp_evaluator"
SERVICE_NAME = "~/evaluate_grasp"
EVERY_REQUEST = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
"""Requests wait as long as it takes until those before them are answered."""

EXECUTOR_THREADS = 4
"""One waits for the simulation, one for the mesher; the others keep status and parameters alive."""


class EvaluatorNode(Node):
    """Evaluates candidate grasps on request.

    Service ``~/evaluate_grasp``, and those of ``object_services.py``; topics and parameters are listed in ``topics.py``
    and ``parameters.py``.
    The simulation has a thread of its own, so that the node stays responsive to everything else.
    """

    def __init__(self) -> None:
        super().__init__(NODE_NAME)
        declare_parameters(self)
        self._outputs = Outputs(self)
        self._status = StatusReporter(self, self._outputs)
        self._stop = Event()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="evaluation")
        self.create_service(
            EvaluateGrasp,
            SERVICE_NAME,
            self._evaluate_grasp,
            qos_profile=EVERY_REQUEST,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self._registry = ObjectRegistry()
        self._object_services = ObjectServices(self, self._registry)
        gripper = load_gripper(self.get_parameter("gripper").value)
        send_robot_description(self._outputs, gripper, self.get_clock().now().nanoseconds)
        self._become_idle()
        self.get_logger().info(f"ready: {self.resolve_service_name(SERVICE_NAME)}")

    def stop(self) -> None:
        """End the running evaluation, if any, and take no more; the caller gets what is finished, the rest CANCELED."""
        self._stop.set()
        self._worker.shutdown(cancel_futures=True)

    def _evaluate_grasp(self, request: EvaluateGrasp.Request, _: EvaluateGrasp.Response) -> EvaluateGrasp.Response:
        try:
            answer = self._worker.submit(self._answer, request.request)
        except RuntimeError:  # waited for its turn until the evaluator was stopped
            return _refusal(ResultCode.CANCELED, "the evaluator is shutting down")
        return answer.result()

    def _answer(self, request: EvaluationRequest) -> EvaluateGrasp.Response:
        """Answer a request; whatever goes wrong is an answer, too."""
        start = time.monotonic()
        run = EvaluationRun(self, self._outputs, self._status, parameter_values(self), self._registry, self._stop)
        try:
            response = run.answer(request)
        except DefgraspError as error:
            response = _refusal(error.code, str(error))
        except MemoryError:
            response = _refusal(ResultCode.RESOURCE_EXHAUSTED, "not enough memory; use a coarser mesh or fewer grasps")
        except Exception as error:
            self.get_logger().error(f"run {run.id} failed:\n{traceback.format_exc()}")
            response = _refusal(ResultCode.OPERATION_FAILED, f"{type(error).__name__}: {error}")
        self._become_idle()
        self._log_answer(run.id, response, time.monotonic() - start)
        return response

    def _become_idle(self) -> None:
        self._status.idle(self.get_parameter("device").value)

    def _log_answer(self, run_id: str, response: EvaluateGrasp.Response, duration: float) -> None:
        result = response.result
        code = ResultCode(result.code).name
        log = f", log {response.log_uri}" if response.log_uri else ""
        self.get_logger().info(f"run {run_id}: {code} after {duration:.1f} s: {result.message}{log}")


def _refusal(code: ResultCode, message: str) -> EvaluateGrasp.Response:
    return EvaluateGrasp.Response(result=Result(code=code, message=message))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node until SIGINT or SIGTERM; a running evaluation then ends early, is answered and its log closed."""
    ended = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = EvaluatorNode()
    executor = MultiThreadedExecutor(num_threads=EXECUTOR_THREADS)
    executor.add_node(node)

    def spin() -> None:
        try:
            executor.spin()
        finally:
            ended.set()

    spinner = Thread(target=spin, name="executor")
    spinner.start()
    ended.wait()
    node.stop()
    executor.shutdown()
    spinner.join()
    # The executor's own threads may still be sending the last answer; Python joins them before exit handlers run.
    atexit.register(rclpy.try_shutdown)


if __name__ == "__main__":
    main()
