"""The status while it cannot be published."""

from __future__ import annotations

from threading import Event, Thread
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
msg = pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from rclpy.clock import Clock  # noqa: E402

from defgrasp_ros.evaluation import Phase, Progress  # noqa: E402
from defgrasp_ros.ros.status_reporter import StatusReporter  # noqa: E402

TIMEOUT = 30.0


class SlowDisk:
    """Outputs that take the first message only when they are let go."""

    def __init__(self) -> None:
        self.busy, self.let_go = Event(), Event()
        self.sent: list[msg.EvaluatorStatus] = []

    def send(self, topic: object, message: msg.EvaluatorStatus, time: int) -> None:
        self.busy.set()
        assert self.let_go.wait(TIMEOUT)
        self.sent.append(message)


@pytest.mark.timeout(TIMEOUT)
def test_status_is_known_while_a_report_waits_for_the_disk() -> None:
    """Whoever asks gets the present status, not to be changed by what comes later; nothing is lost afterwards."""
    disk = SlowDisk()
    node = SimpleNamespace(get_clock=Clock, create_timer=lambda *_, **__: None)
    reporter = StatusReporter(node, disk, lambda: 3)
    heard: list[str] = []
    reporter.follow(SimpleNamespace(on_status=lambda status: heard.append(status.run_id)))

    def evaluate() -> None:
        reporter.meshing("run 7", "block", 2, "cpu")
        reporter.running(Progress(Phase.SQUEEZE, 0.1, 0.2, 2, 2))

    evaluation = Thread(target=evaluate)
    evaluation.start()
    assert disk.busy.wait(TIMEOUT)
    status = reporter.current()
    assert (status.run_id, status.state, status.queued_goals) == ("run 7", status.STATE_MESHING, 3)
    assert status.header.stamp.sec > 0 and not heard
    disk.let_go.set()
    evaluation.join(TIMEOUT)
    assert [each.state for each in disk.sent] == [status.STATE_MESHING, status.STATE_RUNNING]
    assert heard == ["run 7"] * 2 and status.state == status.STATE_MESHING
