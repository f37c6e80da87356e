"""What a client gets back, as plain data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from defgrasp_interfaces.action import EvaluateGrasps
from defgrasp_interfaces.msg import EvaluatorStatus
from defgrasp_interfaces.srv import EvaluateGrasp

from defgrasp_ros.client.failures import refusal
from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import GraspEvaluation, Phase, Progress
from defgrasp_ros.ros.result_conversion import evaluation_from_message


@dataclass(frozen=True)
class EvaluationAnswer:
    """What the evaluator answered."""

    evaluations: list[GraspEvaluation]
    """One per grasp, in the order of the request."""
    code: ResultCode
    """OK, or why the run ended early (CANCELED, TIMEOUT, or a failure): evaluations that were not finished then have
    that code, too."""
    message: str
    """Summary; also says if something went wrong beside the evaluation, e.g. the log."""
    log_path: Path | None
    """The run's log on the evaluator's machine; None if none was written."""


@dataclass
class EvaluationProgress(Progress):
    """How far the evaluator is; while a goal waits, with the one before it."""

    run_id: str = ""
    """Name of the run, also of its log; empty when idle."""
    object_name: str = ""
    """As the request has it."""
    finished_grasps: int = 0
    """Grasps whose evaluation is known."""
    queued_goals: int = 0
    """Goals that wait behind the running one."""
    time_remaining: float = math.nan
    """Estimate of the wall time until the result [s]; nan: unknown."""


def answer_from_message(message: EvaluateGrasp.Response | EvaluateGrasps.Result) -> EvaluationAnswer:
    """Return the answer of a message.

    Raises:
        DefgraspError: If the request was refused, or failed before the first evaluation: the class of
            ``defgrasp_ros.errors`` with the evaluator's code, and the run's log as a note.
    """
    log_path = Path(unquote(urlsplit(message.log_uri).path)) if message.log_uri else None
    if not message.evaluations:
        error = refusal(message.result)
        if log_path:
            error.add_note(f"what happened before is in the log {log_path}")
        raise error
    return EvaluationAnswer(
        evaluations=[evaluation_from_message(evaluation) for evaluation in message.evaluations],
        code=ResultCode(message.result.code),
        message=message.result.message,
        log_path=log_path,
    )


def progress_from_message(status: EvaluatorStatus, time_remaining: float = math.nan) -> EvaluationProgress:
    """Return the progress that a status tells."""
    return EvaluationProgress(
        phase=Phase(status.phase),
        fraction=status.progress,
        simulated_time=status.simulated_time,
        active_grasps=status.active_grasps,
        grasp_count=status.grasp_count,
        run_id=status.run_id,
        object_name=status.object_name,
        finished_grasps=status.finished_grasps,
        queued_goals=status.queued_goals,
        time_remaining=time_remaining,
    )
