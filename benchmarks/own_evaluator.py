"""An evaluator for a benchmark: a process of its own, on a ROS domain of its own."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HIGHEST_DOMAIN_ID = 101
"""Above it ports collide with those that the system hands out."""
START_TIMEOUT = 120.0
"""For compiling the kernels, where they are not yet [s]."""


@contextmanager
def own_evaluator(log_directory: Path) -> Iterator[subprocess.Popen]:
    """Run the evaluator until the end of the block; this process and those that it starts are on its domain then."""
    os.environ["ROS_DOMAIN_ID"] = str(random.randint(1, HIGHEST_DOMAIN_ID))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    command = [sys.executable, "-m", "defgrasp_ros.ros.evaluator_node"]
    parameters = ["--ros-args", "-p", f"record.directory:={log_directory}", "--log-level", "warn"]
    with subprocess.Popen([*command, *parameters]) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
