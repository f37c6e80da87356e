"""How fast the simulation is, compared with the world."""

from __future__ import annotations

import math
from collections import deque

from defgrasp_ros.evaluation import Progress

WINDOW = 5.0
"""Wall time over which it is averaged [s]."""


class RealTimeFactor:
    """Simulated time of all running grasps together per wall time, over the last seconds."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, float]] = deque()
        self._simulated_time = 0.0
        self._grasp_time = 0.0

    def update(self, progress: Progress, now: float) -> float:
        """Take a report of progress at a wall time [s]; return the factor [-], nan for the first."""
        self._grasp_time += (progress.simulated_time - self._simulated_time) * progress.active_grasps
        self._simulated_time = progress.simulated_time
        self._marks.append((now, self._grasp_time))
        while len(self._marks) > 2 and self._marks[1][0] <= now - WINDOW:
            self._marks.popleft()
        start, grasp_time = self._marks[0]
        return (self._grasp_time - grasp_time) / (now - start) if now > start else math.nan
