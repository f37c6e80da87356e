"""What ends a run before all is done: its stop signal, or an observer that wants no more."""

from __future__ import annotations

from dataclasses import dataclass

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import EvaluationObserver
from defgrasp_ros.stop_signal import StopSignal


@dataclass(frozen=True)
class Failure:
    """Why a grasp, or one direction of it, did not get to the end."""

    code: ResultCode
    message: str


class Interruption:
    """Watches whether a run has to end now; once it has to, it stays so.

    Args:
        observer: Is asked whether the run is canceled.
        stop: Ends the run on demand, or at its time limit.
    """

    def __init__(self, observer: EvaluationObserver, stop: StopSignal):
        self._observer = observer
        self._stop = stop

    def reason(self) -> Failure | None:
        """Return why the run has to end now; None: it may go on."""
        if not self._stop.is_set() and self._observer.should_stop():
            self._stop.set(ResultCode.CANCELED, "canceled")
        return Failure(self._stop.code, self._stop.reason) if self._stop.is_set() else None
