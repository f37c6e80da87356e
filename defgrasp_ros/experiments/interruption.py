"""What ends a run before all is done: whoever asked for it, or a limit of its wall time."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from defgrasp_ros.errors import InvalidOptionsError, ResultCode
from defgrasp_ros.evaluation import EvaluationObserver


@dataclass(frozen=True)
class Failure:
    """Why a grasp, or one direction of it, did not get to the end."""

    code: ResultCode
    message: str


class Interruption:
    """Watches whether a run has to end now; once it has to, it stays so.

    Args:
        observer: Is asked whether the run is canceled.
        time_limit: Wall time from now on [s]; None: no limit.

    Raises:
        InvalidOptionsError: If the limit is no positive number.
    """

    def __init__(self, observer: EvaluationObserver, time_limit: float | None = None):
        if time_limit is not None and not (math.isfinite(time_limit) and time_limit > 0.0):
            raise InvalidOptionsError(f"time_limit = {time_limit!r} s must be above 0, or None for no limit")
        self._observer = observer
        self._time_limit = time_limit
        self._end = math.inf if time_limit is None else time.monotonic() + time_limit
        self._reason: Failure | None = None

    def reason(self) -> Failure | None:
        """Return why the run has to end now; None: it may go on."""
        if self._reason is None:
            if self._observer.should_stop():
                self._reason = Failure(ResultCode.CANCELED, "canceled")
            elif time.monotonic() > self._end:
                self._reason = Failure(ResultCode.TIMEOUT, f"stopped at the time limit of {self._time_limit:g} s")
        return self._reason
