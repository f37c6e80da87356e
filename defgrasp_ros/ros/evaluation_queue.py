"""Requests wait here for their turn: first in, first out, one at a time, in a thread of their own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Condition, Thread

from defgrasp_interfaces.msg import EvaluationRequest
from defgrasp_interfaces.srv import EvaluateGrasp
from rclpy.task import Future

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.stop_signal import StopSignal


class EvaluationJob:
    """One request on its way from the caller to the answer.

    Args:
        request: What is asked for.
        on_start: Called in the evaluating thread when it is this job's turn.
    """

    def __init__(self, request: EvaluationRequest, on_start: Callable[[], None] = lambda: None) -> None:
        self.request = request
        self.on_start = on_start
        self.stop = StopSignal()
        """Ends the job early."""
        self.answer: Future = Future()
        """Gets the ``EvaluateGrasp.Response``."""


class EvaluationQueue:
    """Hands one job after the other to the evaluation; paused at first.

    Args:
        evaluate: Answers a job; must not raise. Called in the queue's thread.
        give_up: Answers a job that was ended before its turn.
    """

    def __init__(
        self,
        evaluate: Callable[[EvaluationJob], EvaluateGrasp.Response],
        give_up: Callable[[EvaluationJob], EvaluateGrasp.Response],
    ) -> None:
        self._evaluate = evaluate
        self._give_up = give_up
        self._changed = Condition()
        self._waiting: deque[EvaluationJob] = deque()
        self._running: EvaluationJob | None = None
        self._paused = True
        self._closed = False
        self._thread = Thread(target=self._work, name="evaluation", daemon=True)
        self._thread.start()

    @property
    def waiting_count(self) -> int:
        """Jobs whose turn has not come [-]."""
        return len(self._waiting)

    def is_full(self, most: int) -> bool:
        """Whether as many jobs wait as may; one that could begin at once does not wait."""
        with self._changed:
            return len(self._waiting) >= most + (self._running is None)

    def submit(self, job: EvaluationJob) -> None:
        """Let a job wait for its turn; once the queue is closed it is given up at once."""
        with self._changed:
            if not self._closed:
                self._waiting.append(job)
                self._changed.notify()
                return
        job.stop.set(ResultCode.CANCELED, "the evaluator is shutting down")
        job.answer.set_result(self._give_up(job))

    def end(self, job: EvaluationJob, code: ResultCode, reason: str) -> None:
        """End a job early: a running one soon, a waiting one at once."""
        job.stop.set(code, reason)
        with self._changed:
            if job not in self._waiting:
                return
            self._waiting.remove(job)
        job.answer.set_result(self._give_up(job))

    def end_running(self, code: ResultCode, reason: str) -> bool:
        """End the job that runs; return whether there is one."""
        with self._changed:
            job = self._running
        if job:
            job.stop.set(code, reason)
        return job is not None

    def end_all(self, code: ResultCode, reason: str) -> bool:
        """End every job; return whether one was running, which ends soon."""
        was_running = self.end_running(code, reason)
        with self._changed:
            waiting = list(self._waiting)
        for job in waiting:
            self.end(job, code, reason)
        return was_running

    def pause(self) -> None:
        """Let no further job begin."""
        with self._changed:
            self._paused = True

    def resume(self) -> None:
        """Let jobs begin."""
        with self._changed:
            self._paused = False
            self._changed.notify()

    def close(self) -> None:
        """End every job, take no more, and wait until the last is answered."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self.end_all(ResultCode.CANCELED, "the evaluator is shutting down")
        self._thread.join()

    def _work(self) -> None:
        while job := self._next():
            job.on_start()
            answer = self._evaluate(job)
            with self._changed:
                self._running = None
            job.answer.set_result(answer)

    def _next(self) -> EvaluationJob | None:
        """Wait for the next job; None when the queue is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or (self._waiting and not self._paused))
            if self._closed:
                return None
            self._running = self._waiting.popleft()
            return self._running
