"""The time of a replay: runs with the wall clock, faster, slower, or not at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Condition

from defgrasp_ros.recording.topic import NANOSECONDS

TICK = 0.025
"""Wall time between two calls of the observer while the replay waits [s]."""


class PlaybackTimer:
    """Log time as a function of wall time; ``toggle_pause`` may be called from another thread.

    Args:
        start: Log time at which it begins [ns].
        rate: Log time that passes per wall time [-].
        paused: Whether it begins paused.
    """

    def __init__(self, start: int, rate: float, *, paused: bool = False) -> None:
        self._rate = rate
        self._position = start
        self._changed = Condition()
        self._paused = paused
        self._last_look = time.monotonic_ns()

    @property
    def paused(self) -> bool:
        """Whether the time stands still."""
        return self._paused

    @property
    def position(self) -> int:
        """The log time now [ns]."""
        with self._changed:
            self._advance()
            return self._position

    def toggle_pause(self) -> None:
        """Let the time stand still, or go on."""
        with self._changed:
            self._advance()
            self._paused = not self._paused
            self._changed.notify_all()

    def restart(self, start: int) -> None:
        """Set the log time to ``start`` [ns]."""
        with self._changed:
            self._advance()
            self._position = start

    def wait_until(self, log_time: int, on_tick: Callable[[int], None]) -> None:
        """Wait for a log time [ns], and for the end of a pause; meanwhile tell ``on_tick`` the present one."""
        while (rest := log_time - self.position) > 0 or self._paused:
            on_tick(self._position)
            with self._changed:
                self._changed.wait(TICK if self._paused else min(TICK, rest / self._rate / NANOSECONDS))

    def _advance(self) -> None:
        now = time.monotonic_ns()
        if not self._paused:
            self._position += round((now - self._last_look) * self._rate)
        self._last_look = now
