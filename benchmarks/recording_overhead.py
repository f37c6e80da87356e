"""What publishing and recording everything adds to a run: the same run with and without, in turn.

Run: ``python benchmarks/recording_overhead.py``; it starts an evaluator on a ROS domain of its own, and for the runs
with recording a process that subscribes to every topic. Wall times are those that a client waits; processor times are
those of the evaluator, less sensitive to other work on the machine. Target: at most 10 % of the wall time.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from own_evaluator import START_TIMEOUT, own_evaluator

from defgrasp_ros.client import GraspEvaluatorClient
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.recording.log_summary import summarize_log

BLOCK = box((0.06, 0.04, 0.04), (9, 6, 6))
"""490 nodes."""
MATERIAL = Material(youngs_modulus=2e5)
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
TARGET = 0.10
"""Largest overhead [-]."""

LISTENER = """
import sys
import rclpy
from defgrasp_ros.ros.topics import PUBLISHED, qos_profile
rclpy.init()
node = rclpy.create_node("listener")
for topic in PUBLISHED:
    name = topic.name.replace("~", "/defgrasp_evaluator")
    node.create_subscription(topic.message_class, name, lambda message: None, qos_profile(topic))
while not all(node.count_publishers(topic.name.replace("~", "/defgrasp_evaluator")) for topic in PUBLISHED):
    rclpy.spin_once(node, timeout_sec=0.1)
print("listening", flush=True)
rclpy.spin(node)
"""


@dataclass(frozen=True)
class Cost:
    """What one run took [s]."""

    wall: float
    processor: float


def main() -> int:
    """Measure and print; return 1 if the overhead is above the target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grasps", type=int, default=4)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--hold-time", type=float, default=1.0, help="[s]")
    parser.add_argument("--experiments", default="pickup", help="names with commas, or all")
    arguments = parser.parse_args()
    offsets = np.linspace(-0.01, 0.01, arguments.grasps)
    grasps = [Grasp(np.array([offset, 0.0, 0.0]), FROM_ABOVE, id=f"{1e3 * offset:.1f} mm") for offset in offsets]
    options = EvaluationOptions(experiments=arguments.experiments, pickup_hold_time=arguments.hold_time)
    without: list[Cost] = []
    recorded: list[Cost] = []
    with tempfile.TemporaryDirectory() as folder, own_evaluator(Path(folder)) as node, GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        run(client, node, grasps, options, record=False)  # compiles
        for number in range(arguments.repetitions):
            cost, _ = run(client, node, grasps, options, record=False)
            without.append(cost)
            with listener():
                cost, log = run(client, node, grasps, options, record=True)
            recorded.append(cost)
            print(
                f"{number}: without {without[-1].wall:.2f} s, with {cost.wall:.2f} s; "
                f"processor {without[-1].processor:.2f} s, {cost.processor:.2f} s",
                flush=True,
            )
        assert log is not None
        summary = summarize_log(log)
    overhead = median(each.wall for each in recorded) / median(each.wall for each in without) - 1.0
    processor = median(each.processor for each in recorded) / median(each.processor for each in without) - 1.0
    print(
        f"log: {summary.counts.total()} messages, {1e-6 * summary.size:.2f} MB, "
        f"waited {summary.statistics['waiting_time']} s for the disk"
    )
    print(
        f"overhead: wall {100 * overhead:.1f} %, processor {100 * processor:.1f} % (medians); target {100 * TARGET:g} %"
    )
    return int(overhead > TARGET)


def run(
    client: GraspEvaluatorClient,
    node: subprocess.Popen,
    grasps: list[Grasp],
    options: EvaluationOptions,
    *,
    record: bool,
) -> tuple[Cost, Path | None]:
    """Evaluate the grasps once; return the cost, and the log if there is one."""
    processor, wall = processor_time(node.pid), time.perf_counter()
    answer = client.evaluate_grasps(BLOCK, MATERIAL, grasps, options=options, record=record)
    return Cost(time.perf_counter() - wall, processor_time(node.pid) - processor), answer.log_path


def processor_time(process: int) -> float:
    """Return the time that all threads of a process have used so far [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def listener() -> Iterator[None]:
    """Let another process subscribe to every topic until the end of the block."""
    with subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            process.stdout.readline()
            yield
        finally:
            process.kill()


if __name__ == "__main__":
    sys.exit(main())
