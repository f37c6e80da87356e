"""What is done once per interval of simulated time."""

from __future__ import annotations

ROUNDING = 1e-6
"""Part of an interval by which a sum of time steps may fall short of it through rounding [-]."""


class Periodic:
    """Says when the next time has come; the first is at once.

    Args:
        interval: Simulated time between two times [s].
    """

    def __init__(self, interval: float) -> None:
        self._interval = interval
        self._next = 0.0

    def is_due(self, time: float) -> bool:
        """Whether it is to be done now, at a simulated time [s]."""
        return time >= self._next

    def done(self, time: float) -> None:
        """It was done at this simulated time [s]."""
        self._next = time + (1.0 - ROUNDING) * self._interval
