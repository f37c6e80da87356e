"""The whole way from nothing: start the evaluator, let a planner in another process ask it, show what came out.

Writes the log and the picture of the run below ``demo_output/`` in the current folder.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

OUTPUT = Path("demo_output").resolve()
PLANNER = Path(__file__).with_name("plan_a_grasp.py")
HIGHEST_DOMAIN_ID = 101
"""Domains up to this one are safe from clashes with ephemeral ports on every platform."""
STOP_TIMEOUT = 20.0


def main() -> int:
    """Run node and planner side by side; return the planner's exit status."""
    # A domain of its own keeps the demonstration apart from other nodes in the network.
    domain = str(random.randint(1, HIGHEST_DOMAIN_ID))
    environment = os.environ | {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    OUTPUT.mkdir(parents=True, exist_ok=True)
    evaluator = [sys.executable, "-m", "defgrasp_ros.ros.evaluator_node"]
    parameters = ["--ros-args", "-p", f"record.directory:={OUTPUT / 'logs'}"]
    with (
        (OUTPUT / "evaluator.log").open("w") as messages,
        subprocess.Popen([*evaluator, *parameters], env=environment, stdout=messages, stderr=messages) as node,
    ):
        print(
            f"evaluator started (process {node.pid}, ROS_DOMAIN_ID {domain}); its messages: {messages.name}", flush=True
        )
        try:
            planner = [sys.executable, str(PLANNER), "--picture", str(OUTPUT / "grasps.png")]
            status = subprocess.call(planner, env=environment)
        finally:
            node.send_signal(signal.SIGINT)
            try:
                node.wait(STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                node.kill()
    if status:
        print(f"the planner ended with status {status}; see {messages.name}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
