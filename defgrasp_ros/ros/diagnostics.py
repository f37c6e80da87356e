"""The topic ``/diagnostics``: how the evaluator is, one status per part of it."""

from __future__ import annotations

import dataclasses
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.parameters import log_directory, parameter_values

INTERVAL = 1.0
"""Wall time between two messages [s]."""

LOW_SPACE = 2e9
"""Free space below which there is a warning [B]; a long run with fields needs about as much."""

NO_SPACE = 1e8
"""Free space below which there is an error [B]."""

LONG_WAIT = 1.0
"""Time spent on waiting for the disk above which there is a warning [s]."""

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    """Publishes once a second, if somebody listens.

    Args:
        node: Has the parameters.
        outputs: Knows about the log of the present run.
        device_problem: Tells why the device cannot be used; empty where it can, None before the configuration.
        queued_count: Tells how many requests wait.
        last_failure: Tells when and why the last run failed; empty where it did not.
    """

    def __init__(
        self,
        node: Node,
        outputs: Outputs,
        device_problem: Callable[[], str | None],
        queued_count: Callable[[], int],
        last_failure: Callable[[], str],
    ) -> None:
        self._node = node
        self._outputs = outputs
        self._device_problem = device_problem
        self._queued_count = queued_count
        self._last_failure = last_failure
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(INTERVAL, self._publish, callback_group=MutuallyExclusiveCallbackGroup())

    def _publish(self) -> None:
        if self._publisher.get_subscription_count():
            message = DiagnosticArray(status=self.statuses())
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(message)

    def statuses(self) -> list[DiagnosticStatus]:
        """Return the status of each part."""
        parameters = parameter_values(self._node)
        device = str(parameters["device"])
        parts = {
            "device": self._device(device),
            "queue": self._queue(int(parameters["max_queued_goals"])),
            "last run": self._last_run(),
            "recording": self._recording(),
            "logs": _space(log_directory(parameters), needed=bool(parameters["record.enabled"])),
            "kernel cache": _kernel_cache(),
        }
        name = self._node.get_fully_qualified_name().lstrip("/")
        return [
            DiagnosticStatus(
                level=level,
                name=f"{name}: {part}",
                message=text,
                hardware_id=device,
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
            )
            for part, (level, text, values) in parts.items()
        ]

    def _device(self, name: str) -> tuple[bytes, str, dict]:
        problem = self._device_problem()
        if problem is None:
            return WARN, "not configured", {"device": name}
        if problem:
            return ERROR, problem, {"device": name}
        return OK, "ready", {"device": name, **_device_memory(name)}

    def _queue(self, most: int) -> tuple[bytes, str, dict]:
        count = self._queued_count()
        full = count >= most > 0
        return (WARN if full else OK), f"{count} wait", {"queued_goals": count, "max_queued_goals": most}

    def _recording(self) -> tuple[bytes, str, dict]:
        """Return how the log of the present run is doing."""
        statistics, problem = self._outputs.log_statistics, self._outputs.log_problem
        values = dataclasses.asdict(statistics) if statistics else {}
        if problem:
            return WARN, problem, values
        if statistics is None:
            return OK, "nothing is being logged", values
        if statistics.waiting_time > LONG_WAIT:
            return WARN, f"the run has waited {statistics.waiting_time:.1f} s for the disk", values
        return OK, f"{statistics.message_count} messages", values

    def _last_run(self) -> tuple[bytes, str, dict]:
        failure = self._last_failure()
        return (WARN, failure, {}) if failure else (OK, "has not failed", {})


def _space(folder: Path, *, needed: bool) -> tuple[bytes, str, dict]:
    """Return how much room there is where a folder is, or will be made."""
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not (os.path.isdir(there) and os.access(there, os.W_OK | os.X_OK)):
        return (ERROR if needed else OK), f"{there} is no folder that can be written", {"folder": folder}
    try:
        free = shutil.disk_usage(there).free
    except OSError as error:
        return ERROR, f"{there}: {error.strerror}", {"folder": folder}
    level = OK if free >= LOW_SPACE or not needed else WARN if free >= NO_SPACE else ERROR
    return level, f"{1e-9 * free:.1f} GB free", {"folder": folder, "free_bytes": free}


def _kernel_cache() -> tuple[bytes, str, dict]:
    warp = sys.modules.get("warp")
    folder = warp and warp.config.kernel_cache_dir
    if not folder:
        return OK, "not in use yet", {}
    return _space(Path(folder), needed=True)


def _device_memory(name: str) -> dict[str, int]:
    """Return the memory of a GPU [B]; nothing for the CPU."""
    warp = sys.modules.get("warp")
    if warp is None or not name.startswith("cuda"):
        return {}
    device = warp.get_device(name)
    return {"free_memory_bytes": device.free_memory, "total_memory_bytes": device.total_memory}
