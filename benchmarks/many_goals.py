"""Sends many small goals to an evaluator of its own, one after the other, and watches its memory.

``python benchmarks/many_goals.py 200`` prints the resident memory of the evaluator along the way, how it grew after
the first goals, and how long a goal took; ``--latency`` also asks for the evaluator's description all the time and
prints how long the answers took.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from pathlib import Path
from threading import Event, Thread

import numpy as np
from own_evaluator import START_TIMEOUT, own_evaluator

from defgrasp_ros.client import GraspEvaluatorClient
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box

WARM_UP = 20
"""Goals after which the memory should no longer grow."""
ASK_INTERVAL = 0.05
"""Wall time between two questions [s]."""

FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
QUICK = EvaluationOptions(pickup_hold_time=0.1, platform_speed=1.0, squeeze_time=0.1, time_step=0.02)


def resident_memory(process: int) -> int:
    """Return the resident memory of a process [B]."""
    with open(f"/proc/{process}/statm") as numbers:
        return int(numbers.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def ask_until(ended: Event, latencies: list[float]) -> None:
    """Ask for the description again and again, and note how long each answer took [s]."""
    with GraspEvaluatorClient(node_name="asking_client") as client:
        client.wait_until_ready(START_TIMEOUT)
        while not ended.wait(ASK_INTERVAL):
            start = time.perf_counter()
            client.info()
            latencies.append(time.perf_counter() - start)


def measure(count: int, divisions: int, latency: bool, directory: Path) -> dict:
    """Run the goals and return the figures."""
    block = box((0.03, 0.04, 0.03), (divisions, divisions + 1, divisions))
    grasps = [Grasp(np.zeros(3), FROM_ABOVE, id="centre")]
    memory, durations, latencies, ended = [], [], [], Event()
    with own_evaluator(directory) as evaluator, GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        asking = Thread(target=ask_until, args=(ended, latencies))
        if latency:
            asking.start()
        for index in range(count):
            start = time.perf_counter()
            client.evaluate_grasps(block, Material(youngs_modulus=1e5), grasps, options=QUICK)
            durations.append(time.perf_counter() - start)
            memory.append(resident_memory(evaluator.pid))
            if index % 10 == 0 or index == count - 1:
                print(f"goal {index:4d}: {1e-6 * memory[-1]:8.2f} MB, {durations[-1]:.2f} s", flush=True)
        ended.set()
        if latency:
            asking.join()
    warm = memory[min(WARM_UP, count // 2)]
    figures = {
        "goals": count,
        "tetrahedra": len(block.tetrahedra),
        "seconds_per_goal": statistics.median(durations),
        "warm_memory_mb": 1e-6 * warm,
        "growth_percent": 100.0 * (memory[-1] - warm) / warm,
    }
    if latencies:
        figures["latency_median_ms"] = 1e3 * statistics.median(latencies)
        figures["latency_95_ms"] = 1e3 * float(np.percentile(latencies, 95))
        figures["latency_max_ms"] = 1e3 * max(latencies)
    return figures


def main() -> None:
    """Read the command line and print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=200, help="number of goals")
    parser.add_argument("--divisions", type=int, default=2, help="elements along an edge of the block")
    parser.add_argument("--latency", action="store_true", help="ask for the description meanwhile")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="defgrasp_goals_") as directory:
        print(json.dumps(measure(arguments.count, arguments.divisions, arguments.latency, Path(directory))))


if __name__ == "__main__":
    main()
