"""One request from message to answer: check and read it, simulate, log, answer."""

from __future__ import annotations

import traceback
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from builtin_interfaces.msg import Time
from defgrasp_interfaces import msg
from defgrasp_interfaces.srv import EvaluateGrasp
from rclpy.node import Node

from defgrasp_ros.errors import (
    CanceledError,
    DefgraspError,
    EmptyGraspListError,
    InvalidGraspError,
    ResultCode,
    TooManyGraspsError,
)
from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper, load_gripper
from defgrasp_ros.mesh.limited_process import interruptible
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.recording import provenance, run_attachments
from defgrasp_ros.ros.object_registry import ObjectRegistry
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.parameters import (
    experiment_defaults,
    log_directory,
    logged_topics,
    max_log_size,
    mesh_directories,
)
from defgrasp_ros.ros.request_conversion import grasp_from_message, object_from_message, options_from_message
from defgrasp_ros.ros.result_conversion import evaluation_to_message
from defgrasp_ros.ros.run_observer import RunObserver
from defgrasp_ros.ros.status_reporter import StatusReporter
from defgrasp_ros.ros.topics import REQUEST
from defgrasp_ros.stop_signal import StopSignal


@dataclass(frozen=True)
class CheckedGrasps:
    """The grasps of a request: those that can be simulated, and the verdict on the others."""

    valid: dict[int, Grasp]
    """By index in the request."""
    refused: list[GraspEvaluation]


class EvaluationRun:
    """Evaluates the grasps of one request.

    Args:
        node: For its clock and logger.
        outputs: Takes the messages.
        status: Is told what happens.
        parameters: Values of the node's parameters.
        registry: Objects known by name.
        stop: Ends the run early when set.
    """

    def __init__(
        self,
        node: Node,
        outputs: Outputs,
        status: StatusReporter,
        parameters: dict,
        registry: ObjectRegistry,
        stop: StopSignal,
    ) -> None:
        self.id = f"{datetime.now():%Y_%m_%d-%H_%M_%S}-{uuid.uuid4().hex[:6]}"
        self._clock = node.get_clock()
        self._logger = node.get_logger()
        self._outputs = outputs
        self._status = status
        self._parameters = parameters
        self._registry = registry
        self._stop = stop
        self.log_uri = ""
        """Where the log is once the run has ended, in whatever way; empty if there is none."""
        self.recording_problem = ""
        """Why there is no complete log; empty where there is one, or none was asked for."""

    def answer(self, request: msg.EvaluationRequest) -> EvaluateGrasp.Response:
        """Evaluate the grasps; one without meaning gets its own code, and the others are evaluated all the same.

        A run that ends early, on demand or by a failure, answers with what is finished; the rest gets the run's code.

        Raises:
            DefgraspError: If the request as a whole is refused, naming field and value.
        """
        if request.time_limit:
            self._stop.limit(request.time_limit)
        grasps = check_grasps(request.grasps, self._parameters["max_grasps"])
        gripper = load_gripper(request.gripper or self._parameters["gripper"])
        options = options_from_message(request.options, experiment_defaults(self._parameters))
        self._status.meshing(self.id, request.object.name, len(request.grasps), self._parameters["device"])
        folders = mesh_directories(self._parameters)
        try:
            with interruptible(self._stop.is_set):
                object_model = object_from_message(
                    request.object, self._parameters["max_tetrahedra"], folders, self._registry
                )
        except CanceledError:
            return full_answer(request, self._stop.code, self._stop.reason)
        self._logger.info(
            f"run {self.id}: object '{object_model.name}' of {len(object_model.mesh.tetrahedra)} tetrahedra, "
            f"{len(request.grasps)} grasps on {self._parameters['device']}"
        )
        if request.options.record and self._parameters["record.enabled"]:
            self._start_log(object_model, gripper, options)
        try:
            return self._simulate(request, object_model, grasps, gripper, options)
        finally:
            self._status.finishing()
            log_path, self.recording_problem = self._outputs.end_log()
            self.log_uri = log_path.as_uri() if log_path else ""

    def _start_log(self, object_model: ObjectModel, gripper: Gripper, options: EvaluationOptions) -> None:
        mesh, parameters = object_model.mesh, self._parameters
        self._outputs.start_log(
            log_directory(parameters),
            self.id,
            provenance(parameters["device"], parameters, gripper, options, mesh.element_order),
            run_attachments(mesh, gripper),
            topics=logged_topics(parameters),
            max_size=max_log_size(parameters),
        )

    def _simulate(
        self,
        request: msg.EvaluationRequest,
        object_model: ObjectModel,
        grasps: CheckedGrasps,
        gripper: Gripper,
        options: EvaluationOptions,
    ) -> EvaluateGrasp.Response:
        from defgrasp_ros.experiments import evaluate_grasps  # loads the simulator

        start_time = self._clock.now().nanoseconds
        self._outputs.log(REQUEST, request, start_time)
        observer = RunObserver(
            self._outputs,
            self._status,
            grasps.valid,
            object_model.mesh,
            gripper,
            self._parameters,
            return_fields=options.return_fields,
            start_time=start_time,
        )
        for evaluation in grasps.refused:
            observer.send_evaluation(evaluation)
        device = self._parameters["device"]
        try:
            evaluate_grasps(object_model, list(grasps.valid.values()), gripper, options, device, observer, self._stop)
        except Exception as error:
            if not observer.messages:
                raise
            self._logger.error(f"run {self.id} failed:\n{traceback.format_exc()}")
            return full_answer(request, *failure(error), observer.messages)
        return full_answer(request, self._stop.code, self._stop.reason, observer.messages)


def full_answer(
    request: msg.EvaluationRequest,
    code: ResultCode,
    reason: str,
    known: Mapping[int, msg.GraspEvaluation] | None = None,
) -> EvaluateGrasp.Response:
    """Return the answer to a request of which a part may have no evaluation.

    Args:
        request: What was asked for.
        code: What the others get.
        reason: Why.
        known: Evaluations that are there, by their index in the request.
    """
    evaluations = dict(known or {})
    for index, grasp in enumerate(request.grasps):
        if index not in evaluations:
            rest = GraspEvaluation(index, grasp.id, code=code, message=reason)
            evaluations[index] = evaluation_to_message(rest, Time())
    in_order = [evaluations[index] for index in sorted(evaluations)]
    codes = Counter(ResultCode(evaluation.result.code) for evaluation in in_order)
    counts = ", ".join(f"{count} {each.name}" for each, count in codes.most_common())
    message = f"{len(in_order)} grasps: {counts}"
    if not codes[code]:  # all was finished nevertheless
        code = ResultCode.OK
    if code != ResultCode.OK:
        message += f"; {reason}"
    return EvaluateGrasp.Response(result=msg.Result(code=code, message=message), evaluations=in_order)


def failure(error: Exception) -> tuple[ResultCode, str]:
    """Return code and text of what went wrong."""
    if isinstance(error, DefgraspError):
        return error.code, str(error)
    if isinstance(error, MemoryError):
        return ResultCode.RESOURCE_EXHAUSTED, "not enough memory; use a coarser mesh or fewer grasps"
    return ResultCode.OPERATION_FAILED, f"{type(error).__name__}: {error}"


def check_grasps(messages: Sequence[msg.Grasp], max_grasps: int) -> CheckedGrasps:
    """Read the grasps of a request.

    Raises:
        EmptyGraspListError: If there is none.
        TooManyGraspsError: If there are more than ``max_grasps``.
        InvalidGraspError: If not one of them has a meaning.
    """
    if not messages:
        raise EmptyGraspListError("the request has no grasps; give at least one")
    if len(messages) > max_grasps:
        raise TooManyGraspsError(
            f"the request has {len(messages)} grasps, more than max_grasps = {max_grasps}; ask in several requests"
        )
    valid: dict[int, Grasp] = {}
    errors: dict[int, InvalidGraspError] = {}
    for index, message in enumerate(messages):
        try:
            valid[index] = grasp_from_message(message)
        except InvalidGraspError as error:
            errors[index] = error
    if not valid:
        raise errors[0]
    refused = [GraspEvaluation(i, messages[i].id, code=error.code, message=str(error)) for i, error in errors.items()]
    return CheckedGrasps(valid, refused)
