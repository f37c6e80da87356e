"""A goal that an evaluator works on."""

from __future__ import annotations

from collections.abc import Callable

from defgrasp_interfaces.action import EvaluateGrasps
from rclpy.action.client import ClientGoalHandle
from rclpy.task import Future

from defgrasp_ros.client.answer import EvaluationAnswer, EvaluationProgress, answer_from_message, progress_from_message
from defgrasp_ros.client.connection import Connection
from defgrasp_ros.evaluation import GraspEvaluation
from defgrasp_ros.ros.result_conversion import evaluation_from_message


class GoalReports:
    """Hands the feedback of a goal to the caller's functions, in the client's thread.

    Args:
        on_progress: Told a few times a second how far the evaluator is.
        on_evaluation: Told each evaluation as soon as it is there, without fields over the mesh.
    """

    def __init__(
        self,
        on_progress: Callable[[EvaluationProgress], None] | None,
        on_evaluation: Callable[[GraspEvaluation], None] | None,
    ) -> None:
        self._on_progress = on_progress
        self._on_evaluation = on_evaluation
        self.error: Exception | None = None
        """What one of the functions raised; they are then called no more."""

    def take(self, message: EvaluateGrasps.Impl.FeedbackMessage) -> None:
        """Take a feedback."""
        if self.error is None:
            try:
                self._hand_on(message.feedback)
            except Exception as error:  # must not end the thread that takes the answers
                self.error = error

    def _hand_on(self, feedback: EvaluateGrasps.Feedback) -> None:
        if self._on_evaluation:
            for evaluation in feedback.finished:
                self._on_evaluation(evaluation_from_message(evaluation))
        if self._on_progress:
            self._on_progress(progress_from_message(feedback.status, feedback.time_remaining))


class EvaluationGoal:
    """An evaluation under way; made by ``GraspEvaluatorClient.start_evaluation``."""

    def __init__(self, connection: Connection, handle: ClientGoalHandle, reports: GoalReports) -> None:
        self._connection = connection
        self._handle = handle
        self._reports = reports
        self._result: Future = connection.in_spinner(handle.get_result_async)

    @property
    def done(self) -> bool:
        """Whether the answer is there."""
        return self._result.done()

    def cancel(self) -> None:
        """Ask the evaluator to end; the answer then comes soon, with what is finished, the rest CANCELED."""
        self._connection.in_spinner(self._handle.cancel_goal_async)

    def answer(self, timeout: float | None = None) -> EvaluationAnswer:
        """Wait for the answer.

        Args:
            timeout: Longest time to wait [s]; None: as long as the evaluator is there.

        Raises:
            EvaluatorGoneError: If the evaluator ends before it answers.
            TimeoutError: If the time is up; the evaluator goes on.
            DefgraspError: If the request is refused: the class of ``defgrasp_ros.errors`` with the evaluator's code.
            Exception: What ``on_progress`` or ``on_evaluation`` raised, when the goal has ended.
        """
        response = self._connection.wait(self._result, self._connection.action_name, timeout)
        if self._reports.error:
            raise self._reports.error
        return answer_from_message(response.result)
