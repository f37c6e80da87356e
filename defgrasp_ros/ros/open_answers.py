"""Answers that the executor still has to send."""

from __future__ import annotations

from threading import Condition, Event

from rclpy.executors import Executor
from rclpy.node import Node

from defgrasp_ros.ros.evaluation_queue import EvaluationJob

SEND_TIMEOUT = 10.0
"""Longest time for the last answers to be sent [s]."""

SENDING_ROUNDS = 3
"""Times that the executor goes through its tasks after the last answer: take it, send it, forget it."""


class OpenAnswers:
    """Lets callbacks wait for answers without a thread, and the end of the node wait until all are sent.

    Args:
        node: Its executor is woken when an answer is there; a callback that waits looks only then.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._jobs: set[EvaluationJob] = set()
        self._changed = Condition()

    def expect(self, job: EvaluationJob) -> None:
        """A callback is going to await the answer to this job."""
        with self._changed:
            self._jobs.add(job)
        job.answer.add_done_callback(lambda _: self._node.executor.wake())

    def hand_over(self, job: EvaluationJob) -> None:
        """The callback has got the answer, and returns it at once."""
        with self._changed:
            self._jobs.remove(job)
            self._changed.notify_all()

    def flush(self, executor: Executor) -> None:
        """Wait until every answer is sent by an executor that spins in another thread."""
        with self._changed:
            self._changed.wait_for(lambda: not self._jobs, SEND_TIMEOUT)
        for _ in range(SENDING_ROUNDS):
            passed = Event()
            executor.create_task(passed.set)
            passed.wait(SEND_TIMEOUT)
