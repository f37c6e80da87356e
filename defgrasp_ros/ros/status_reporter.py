"""Tells what the evaluator is doing."""

from __future__ import annotations

import time
from threading import RLock

from defgrasp_interfaces.msg import EvaluatorStatus
from rclpy.node import Node

from defgrasp_ros.evaluation import Progress
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.topics import STATUS

HEARTBEAT = 1.0
"""Wall time between two reports when nothing changes [s]."""

PROGRESS_INTERVAL = 0.1
"""Least wall time between two reports of which the second only says that a phase goes on [s]."""


class StatusReporter:
    """Publishes the status on every change of state or phase, while a phase goes on, and once a second."""

    def __init__(self, node: Node, outputs: Outputs) -> None:
        self._clock = node.get_clock()
        self._outputs = outputs
        self._lock = RLock()
        self._status = EvaluatorStatus()
        self._last_report = 0.0
        node.create_timer(HEARTBEAT, self._report)

    def idle(self, device: str) -> None:
        """Nothing is asked for."""
        self._become(EvaluatorStatus(state=EvaluatorStatus.STATE_IDLE, device=device))

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
            has_changed = before != (status.state, status.phase, status.active_grasps)
            if has_changed or time.monotonic() - self._last_report >= PROGRESS_INTERVAL:
                self._report()

    def finishing(self) -> None:
        """The simulation is over; log and answer are being written."""
        with self._lock:
            self._status.state = EvaluatorStatus.STATE_FINISHING
            self._report()

    def _become(self, status: EvaluatorStatus) -> None:
        with self._lock:
            self._status = status
            self._report()

    def _report(self) -> None:
        with self._lock:
            now = self._clock.now()
            self._status.header.stamp = now.to_msg()
            self._outputs.send(STATUS, self._status, now.nanoseconds)
            self._last_report = time.monotonic()
