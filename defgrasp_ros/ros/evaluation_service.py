"""The service ``~/evaluate_grasp``: the short form of the action, for a few grasps."""

from __future__ import annotations

from collections.abc import Callable

from defgrasp_interfaces.msg import Result
from defgrasp_interfaces.srv import EvaluateGrasp
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from defgrasp_ros.errors import DefgraspError
from defgrasp_ros.ros.evaluation_queue import EvaluationJob, EvaluationQueue
from defgrasp_ros.ros.open_answers import OpenAnswers

SERVICE_NAME = "~/evaluate_grasp"
EVERY_REQUEST = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
"""No request is lost, however many come at once."""


class EvaluationService:
    """Puts requests into the queue; the answers are sent when they are there, and no thread waits for them.

    Args:
        node: Offers the service.
        queue: Takes the requests.
        require_room: Raises a ``DefgraspError`` where no request can be taken now.
        open_answers: Counts the requests that have no answer yet.
    """

    def __init__(
        self, node: Node, queue: EvaluationQueue, require_room: Callable[[], None], open_answers: OpenAnswers
    ) -> None:
        self._queue = queue
        self._require_room = require_room
        self._open_answers = open_answers
        node.create_service(
            EvaluateGrasp,
            SERVICE_NAME,
            self._evaluate,
            qos_profile=EVERY_REQUEST,
            callback_group=ReentrantCallbackGroup(),
        )

    async def _evaluate(self, request: EvaluateGrasp.Request, _: EvaluateGrasp.Response) -> EvaluateGrasp.Response:
        try:
            self._require_room()
        except DefgraspError as error:
            return EvaluateGrasp.Response(result=Result(code=error.code, message=str(error)))
        job = EvaluationJob(request.request)
        self._open_answers.expect(job)
        self._queue.submit(job)
        answer = await job.answer
        self._open_answers.hand_over(job)
        return answer
