"""Tells what the evaluator is doing."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from copy import copy
from threading import Lock
from typing import Protocol

from defgrasp_interfaces.msg import EvaluatorStatus, GraspEvaluation
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from defgrasp_ros.evaluation import Progress
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.topics import STATUS

HEARTBEAT = 1.0
"""Wall time between two reports when nothing changes [s]."""

PROGRESS_INTERVAL = 0.1
"""Least wall time between two reports of which the second only says that a phase goes on [s]."""

RATE_WINDOW = 5.0
"""Wall time over which the real-time factor is measured [s]."""


class StatusFollower(Protocol):
    """Wants to know what is published."""

    def on_status(self, status: EvaluatorStatus) -> None:
        """The status was reported."""

    def on_evaluation(self, status: EvaluatorStatus, evaluation: GraspEvaluation) -> None:
        """A grasp of the running request has its evaluation, without fields over the mesh."""


class StatusReporter:
    """Publishes the status on every change of state or phase, while a phase goes on, and once a second.

    Publishing can take long where the log's disk is slow; whoever asks for the status meanwhile does not wait for it.

    Args:
        node: For its clock, and a timer.
        outputs: Takes the messages.
        queued_count: Tells how many requests wait.
    """

    def __init__(self, node: Node, outputs: Outputs, queued_count: Callable[[], int]) -> None:
        self._clock = node.get_clock()
        self._outputs = outputs
        self._queued_count = queued_count
        self._reporting = Lock()
        """One report after the other, to followers and topic alike."""
        self._lock = Lock()
        """Of what follows; never held while something is sent."""
        self._status = EvaluatorStatus(state=EvaluatorStatus.STATE_INACTIVE)
        self._followers: list[StatusFollower] = []
        self._speed = RealTimeFactor()
        self._last_report = 0.0
        node.create_timer(HEARTBEAT, self.report, callback_group=MutuallyExclusiveCallbackGroup())

    def follow(self, follower: StatusFollower) -> None:
        """Let somebody know from now on; called in whatever thread reports."""
        with self._lock:
            self._followers.append(follower)

    def unfollow(self, follower: StatusFollower) -> None:
        """Let somebody know no longer, but for what is being reported at this moment."""
        with self._lock:
            self._followers.remove(follower)

    def current(self) -> EvaluatorStatus:
        """Return the status at this moment, as a message of its own."""
        return self._at(self._clock.now())

    def idle(self, device: str) -> None:
        """Nothing is asked for."""
        self._become(EvaluatorStatus(state=EvaluatorStatus.STATE_IDLE, device=device))

    def inactive(self, device: str) -> None:
        """No request is taken."""
        self._become(EvaluatorStatus(state=EvaluatorStatus.STATE_INACTIVE, device=device))

    def meshing(self, run_id: str, object_name: str, grasp_count: int, device: str) -> None:
        """A request is being read."""
        self._become(
            EvaluatorStatus(
                state=EvaluatorStatus.STATE_MESHING,
                run_id=run_id,
                object_name=object_name,
                grasp_count=grasp_count,
                device=device,
            )
        )

    def running(self, progress: Progress) -> None:
        """The simulation got further."""
        with self._lock:
            status = self._status
            before = (status.state, status.phase, status.active_grasps)
            status.state = EvaluatorStatus.STATE_RUNNING
            status.phase = int(progress.phase)
            status.progress = float(progress.fraction)
            status.simulated_time = float(progress.simulated_time)
            status.active_grasps = int(progress.active_grasps)
            self._speed.advance(status.simulated_time, status.active_grasps)
            has_changed = before != (status.state, status.phase, status.active_grasps)
        if has_changed or time.monotonic() - self._last_report >= PROGRESS_INTERVAL:
            self.report()

    def finished(self, evaluation: GraspEvaluation) -> None:
        """A grasp of the running request has its evaluation."""
        with self._lock:
            self._status.finished_grasps += 1
        with self._reporting:
            status = self.current()
            for follower in self._present_followers():
                follower.on_evaluation(status, evaluation)

    def finishing(self) -> None:
        """The simulation is over; log and answer are being written."""
        with self._lock:
            self._status.state = EvaluatorStatus.STATE_FINISHING
        self.report()

    def report(self) -> None:
        """Publish the present status."""
        with self._reporting:
            now = self._clock.now()
            status = self._at(now)
            self._outputs.send(STATUS, status, now.nanoseconds)
            self._last_report = time.monotonic()
            for follower in self._present_followers():
                follower.on_status(status)

    def _become(self, status: EvaluatorStatus) -> None:
        with self._lock:
            self._status = status
            self._speed = RealTimeFactor()
        self.report()

    def _present_followers(self) -> list[StatusFollower]:
        with self._lock:
            return list(self._followers)

    def _at(self, now: Time) -> EvaluatorStatus:
        with self._lock:
            status, speed = copy(self._status), self._speed.value
        status.header = Header(stamp=now.to_msg())
        status.queued_goals = self._queued_count()
        status.real_time_factor = speed if status.state == EvaluatorStatus.STATE_RUNNING else math.nan
        return status


class RealTimeFactor:
    """Simulated time of all running grasps per wall time, over the last seconds."""

    def __init__(self) -> None:
        self._last_time = 0.0
        self._total = 0.0
        self._history: deque[tuple[float, float]] = deque([(time.monotonic(), 0.0)])

    def advance(self, simulated_time: float, active_grasps: int) -> None:
        """Take note of a simulated time since the start of the run [s]."""
        now = time.monotonic()
        self._total += max(0.0, simulated_time - self._last_time) * active_grasps
        self._last_time = simulated_time
        self._history.append((now, self._total))
        while now - self._history[0][0] > RATE_WINDOW and len(self._history) > 2:
            self._history.popleft()

    @property
    def value(self) -> float:
        """[-]; nan before the first step."""
        (first, before), (last, after) = self._history[0], self._history[-1]
        return (after - before) / (last - first) if last > first else math.nan
