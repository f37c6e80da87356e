"""Answers one request after the other; whatever goes wrong is an answer, too."""

from __future__ import annotations

import time
import traceback
from datetime import datetime

from defgrasp_interfaces.msg import Result
from defgrasp_interfaces.srv import EvaluateGrasp
from rclpy.node import Node

from defgrasp_ros.errors import DefgraspError, ResultCode
from defgrasp_ros.ros.evaluation_queue import EvaluationJob
from defgrasp_ros.ros.evaluation_run import EvaluationRun, failure, full_answer
from defgrasp_ros.ros.object_registry import ObjectRegistry
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.parameters import parameter_values
from defgrasp_ros.ros.status_reporter import StatusReporter

NO_FAILURE = (ResultCode.OK, ResultCode.CANCELED, ResultCode.TIMEOUT)
"""Codes of runs that did what was asked."""


class Evaluator:
    """Does the jobs of the queue.

    Args:
        node: For its parameters, clock and logger.
        outputs: Takes the messages.
        status: Is told what happens.
        registry: Objects known by name.
    """

    def __init__(self, node: Node, outputs: Outputs, status: StatusReporter, registry: ObjectRegistry) -> None:
        self._node = node
        self._outputs = outputs
        self._status = status
        self._registry = registry
        self.is_active = False
        """Whether requests are taken, which the status says when there is none."""
        self.last_failure = ""
        """When and why the last run failed, or its log; empty where neither did, or there was no run."""

    def answer(self, job: EvaluationJob) -> EvaluateGrasp.Response:
        """Evaluate the grasps of a job."""
        start = time.monotonic()
        parameters = parameter_values(self._node)
        run = EvaluationRun(self._node, self._outputs, self._status, parameters, self._registry, job.stop)
        try:
            response = run.answer(job.request)
        except Exception as error:
            if not isinstance(error, DefgraspError | MemoryError):
                self._node.get_logger().error(f"run {run.id} failed:\n{traceback.format_exc()}")
            code, text = failure(error)
            response = EvaluateGrasp.Response(result=Result(code=code, message=text))
        response.log_uri = run.log_uri
        if run.recording_problem:
            response.result.message += f"; {run.recording_problem}"
        self.rest()
        self._note(run, response, time.monotonic() - start)
        return response

    def rest(self) -> None:
        """Report that nothing is done at present."""
        device = self._node.get_parameter("device").value
        (self._status.idle if self.is_active else self._status.inactive)(device)

    def _note(self, run: EvaluationRun, response: EvaluateGrasp.Response, duration: float) -> None:
        result = response.result
        code = ResultCode(result.code)
        log = f", log {response.log_uri}" if response.log_uri else ""
        self._node.get_logger().info(f"run {run.id}: {code.name} after {duration:.1f} s: {result.message}{log}")
        has_failed = code not in NO_FAILURE or run.recording_problem
        when = f"{datetime.now():%Y-%m-%d %H:%M:%S}"
        self.last_failure = f"{when} run {run.id}: {code.name}: {result.message}" if has_failed else ""


def give_up(job: EvaluationJob) -> EvaluateGrasp.Response:
    """Answer a job that was ended before its turn: every grasp has the code of what ended it."""
    return full_answer(job.request, job.stop.code, f"{job.stop.reason}, before its turn")
