"""The action ``~/evaluate_grasps``: goals that wait in the queue, tell how far they are, and can be canceled."""

from __future__ import annotations

from collections.abc import Callable

from defgrasp_interfaces.action import EvaluateGrasps
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from defgrasp_ros.errors import DefgraspError, ResultCode
from defgrasp_ros.ros.evaluation_queue import EvaluationJob, EvaluationQueue
from defgrasp_ros.ros.goal_feedback import GoalFeedback
from defgrasp_ros.ros.open_answers import OpenAnswers
from defgrasp_ros.ros.status_reporter import StatusReporter
from defgrasp_ros.ros.topics import EVERY_FEEDBACK

ACTION_NAME = "~/evaluate_grasps"

RESULT_TIMEOUT = 10
"""How long a result is kept for a caller that did not ask for it yet [s]; results can be large."""

GONE_INTERVAL = 1.0
"""How often the action looks whether there is still a client [s]."""

GONE_COUNT = 3
"""How many such looks in a row must find none before the goals are canceled [-]."""


class Goal:
    """A goal with the job that does it.

    Args:
        handle: The goal as rclpy has it.
    """

    def __init__(self, handle: ServerGoalHandle) -> None:
        self._handle = handle
        self._started = False
        self.feedback = GoalFeedback(handle.publish_feedback)
        self.job = EvaluationJob(handle.request.request, on_start=self._start)
        self.job.answer.add_done_callback(lambda _: self._end())

    def _start(self) -> None:
        self.feedback.start()
        self._execute()

    def _end(self) -> None:
        self.feedback.end()
        self._execute()  # where it was ended before its turn

    def _execute(self) -> None:
        """Let rclpy ask for the result; the goal is then no longer one that waits."""
        if self._started:
            return
        self._started = True
        try:
            self._handle.execute()
        except RuntimeError:  # canceled at this very moment; rclpy then asks for the result of a canceled goal
            self._handle.execute()


class EvaluationAction:
    """Puts goals into the queue, cancels them, and hands their results back.

    Where the last action client has left the graph, its goals are canceled: nobody would get their results.

    Args:
        node: Offers the action.
        queue: Takes the goals.
        status: What the feedback tells.
        require_room: Raises a ``DefgraspError`` where no goal can be taken now.
        open_answers: Counts the goals that have no result yet.
    """

    def __init__(
        self,
        node: Node,
        queue: EvaluationQueue,
        status: StatusReporter,
        require_room: Callable[[], None],
        open_answers: OpenAnswers,
    ) -> None:
        self._node = node
        self._queue = queue
        self._status = status
        self._require_room = require_room
        self._open_answers = open_answers
        self._goals: dict[bytes, Goal] = {}
        self._looks_without_client = 0
        group = MutuallyExclusiveCallbackGroup()
        self._server = ActionServer(
            node,
            EvaluateGrasps,
            ACTION_NAME,
            self._result,
            callback_group=group,
            goal_callback=self._decide,
            handle_accepted_callback=self._accept,
            cancel_callback=self._cancel,
            feedback_pub_qos_profile=EVERY_FEEDBACK,
            result_timeout=RESULT_TIMEOUT,
        )
        self._result_service = node.resolve_service_name(f"{ACTION_NAME}/_action/get_result")
        node.create_timer(GONE_INTERVAL, self._look_for_clients, callback_group=group)

    def _decide(self, _: EvaluateGrasps.Goal) -> GoalResponse:
        try:
            self._require_room()
        except DefgraspError as error:
            self._node.get_logger().warning(f"goal rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accept(self, handle: ServerGoalHandle) -> None:
        goal = self._goals[bytes(handle.goal_id.uuid)] = Goal(handle)
        self._status.follow(goal.feedback)
        self._open_answers.expect(goal.job)
        self._queue.submit(goal.job)

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        self._node.executor.create_task(self._end, handle)
        return CancelResponse.ACCEPT

    def _end(self, handle: ServerGoalHandle) -> None:
        """End a goal that is canceled, once rclpy has given it that state, which follows on ``_cancel``."""
        if handle.is_active and not handle.is_cancel_requested:
            self._node.executor.create_task(self._end, handle)
        elif goal := self._goals.get(bytes(handle.goal_id.uuid)):
            self._queue.end(goal.job, ResultCode.CANCELED, "canceled by the caller")

    async def _result(self, handle: ServerGoalHandle) -> EvaluateGrasps.Result:
        key = bytes(handle.goal_id.uuid)
        goal = self._goals[key]
        answer = await goal.job.answer
        self._status.unfollow(goal.feedback)
        del self._goals[key]
        if answer.result.code == ResultCode.OK:
            handle.succeed()
        elif answer.result.code == ResultCode.CANCELED and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        self._open_answers.hand_over(goal.job)
        return EvaluateGrasps.Result(result=answer.result, evaluations=answer.evaluations, log_uri=answer.log_uri)

    def _look_for_clients(self) -> None:
        alone = bool(self._goals) and not self._node.count_clients(self._result_service)
        self._looks_without_client = self._looks_without_client + 1 if alone else 0
        if self._looks_without_client >= GONE_COUNT:
            for goal in list(self._goals.values()):
                self._queue.end(goal.job, ResultCode.CANCELED, "its client is gone")
