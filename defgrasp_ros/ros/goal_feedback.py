"""Tells the caller of one goal how far it is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from defgrasp_interfaces.action import EvaluateGrasps
from defgrasp_interfaces.msg import EvaluatorStatus, GraspEvaluation

FEEDBACK_INTERVAL = 0.2
"""Least wall time between two feedbacks of which the second only says that a phase goes on [s]."""

LEAST_PROGRESS = 0.01
"""Progress from which on the remaining time is extrapolated [-]."""


class GoalFeedback:
    """Follows the status: at once where a phase begins or a grasp has its evaluation, else a few times a second.

    A goal that waits hears how far the one before it is.

    Args:
        send: Takes a feedback.
    """

    def __init__(self, send: Callable[[EvaluateGrasps.Feedback], None]) -> None:
        self._send = send
        self._is_running = False
        self._has_ended = False
        self._simulated_since: float | None = None
        self._last = 0.0
        self._doing = ("", 0, 0)

    def start(self) -> None:
        """It is the goal's turn."""
        self._is_running = True

    def end(self) -> None:
        """The goal has its answer; what comes now is about others."""
        self._has_ended = True

    def on_status(self, status: EvaluatorStatus) -> None:
        if self._has_ended:
            return
        doing = (status.run_id, status.state, status.phase)
        if doing != self._doing or time.monotonic() - self._last >= FEEDBACK_INTERVAL:
            self._doing = doing
            self._send_now(status, [])

    def on_evaluation(self, status: EvaluatorStatus, evaluation: GraspEvaluation) -> None:
        if self._is_running and not self._has_ended:
            self._send_now(status, [evaluation])

    def _send_now(self, status: EvaluatorStatus, finished: list[GraspEvaluation]) -> None:
        remaining = self._time_remaining(status)
        self._send(EvaluateGrasps.Feedback(status=status, time_remaining=remaining, finished=finished))
        self._last = time.monotonic()

    def _time_remaining(self, status: EvaluatorStatus) -> float:
        """Extrapolate the progress of the simulation so far [s]; nan where nothing is known."""
        if not self._is_running or status.state != EvaluatorStatus.STATE_RUNNING:
            return math.nan
        now = time.monotonic()
        if self._simulated_since is None:
            self._simulated_since = now
        if status.progress < LEAST_PROGRESS:
            return math.nan
        return (now - self._simulated_since) * (1.0 - status.progress) / status.progress
