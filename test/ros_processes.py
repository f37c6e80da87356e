"""Starts the evaluator in a process of its own, on a ROS domain of its own."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

STOP_TIMEOUT = 60.0
"""How long the evaluator may take to end its work after SIGINT [s]."""


@contextmanager
def isolated_ros() -> Iterator[None]:
    """Let ROS in this process and those that it starts see each other and nobody else until the end of the block."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(random.randint(1, 100)))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@contextmanager
def running_evaluator(log_directory: Path, **parameters: object) -> Iterator[subprocess.Popen]:
    """Run the evaluator until the end of the block, in the environment of this process; its output is printed."""
    command = [sys.executable, "-m", "defgrasp_ros.ros.evaluator_node", "--ros-args"]
    values = {"record.directory": log_directory, **parameters}
    given = [part for name, value in values.items() for part in ("-p", f"{name}:={value}")]
    with open(log_directory / "evaluator.txt", "w+") as output:
        process = subprocess.Popen([*command, *given], stdout=output, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(STOP_TIMEOUT)
            finally:
                process.kill()
                process.wait()
                output.seek(0)
                print(output.read())
