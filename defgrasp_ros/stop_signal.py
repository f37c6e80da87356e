"""Why a run should end before it is done, if it should; the one place that knows its time limit."""

from __future__ import annotations

import math
import time
from threading import Lock

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidOptionsError, ResultCode


class StopSignal:
    """Ends one run early: on demand, or when its time is up. The first reason counts; may be used from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._deadline = math.inf
        self._time_limit = math.inf
        self._code: ResultCode | None = None
        self._reason = ""

    def set(self, code: ResultCode, reason: str) -> None:
        """End the run.

        Args:
            code: What the evaluations get that are not finished.
            reason: For people.
        """
        with self._lock:
            if self._code is None:
                self._code, self._reason = code, reason

    def limit(self, seconds: float) -> None:
        """End the run with TIMEOUT after a wall time from now on [s].

        Raises:
            InvalidOptionsError: If it is no positive number.
        """
        self._time_limit = require_in_range(InvalidOptionsError, "time_limit", seconds, 0.0, low_open=True, unit="s")
        self._deadline = time.monotonic() + seconds

    def is_set(self) -> bool:
        """Whether the run should end now."""
        if time.monotonic() >= self._deadline:
            self.set(ResultCode.TIMEOUT, f"stopped at the time limit of {self._time_limit:g} s")
        return self._code is not None

    @property
    def code(self) -> ResultCode:
        """What the evaluations get that are not finished; OK where nothing ends the run."""
        return ResultCode.OK if self._code is None else self._code

    @property
    def reason(self) -> str:
        """For people; empty where nothing ends the run."""
        return self._reason
