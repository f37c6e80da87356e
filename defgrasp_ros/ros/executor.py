"""The executor of the node."""

from __future__ import annotations

from rclpy.executors import MultiThreadedExecutor


class PatientExecutor(MultiThreadedExecutor):
    """Spins callbacks that await something for hours.

    rclpy's own executor notes such a callback anew whenever it looks whether it can go on, and goes through all its
    notes at every turn; here each callback is noted once.
    """

    def spin_once(self, timeout_sec: float | None = None) -> None:
        super().spin_once(timeout_sec)
        self._futures[:] = dict.fromkeys(self._futures)
