"""Watch an evaluation as it goes on, and end it when you have seen enough.

Start the evaluator in one terminal, ``defgrasp_evaluator``, and this in another::

    python examples/watch_and_cancel.py --patience 10

Each grasp is printed as soon as its evaluation is there. After the time of your patience, or with Ctrl-C, the goal is
canceled: what is finished comes back, the rest is CANCELED.
"""

from __future__ import annotations

import argparse
import math
import sys

from defgrasp_ros.client import EvaluationProgress, GraspEvaluatorClient, RegisteredObject
from defgrasp_ros.errors import DefgraspError, ResultCode
from defgrasp_ros.evaluation import GraspEvaluation
from defgrasp_ros.material_library import find_material

START_TIMEOUT = 60.0
"""How long to wait for an evaluator that is only just being started [s]."""


def show_evaluation(evaluation: GraspEvaluation) -> None:
    """Print one result."""
    print(f"\r{evaluation.grasp_id}: {evaluation.code.name} {evaluation.message}", flush=True)


def show_progress(progress: EvaluationProgress) -> None:
    """Print how far the evaluator is, in a line that the next one overwrites."""
    phase = progress.phase.name.lower().replace("_", " ")
    done = f"{progress.finished_grasps}/{progress.grasp_count}"
    left = f"{progress.time_remaining:.0f} s left" if math.isfinite(progress.time_remaining) else ""
    print(f"\r{phase}: {progress.fraction:4.0%}, {done} {left:<15}", end="", flush=True)


def watch(object_name: str, count: int, patience: float) -> ResultCode:
    """Evaluate grasps of an object of the library until they are done or patience is over."""
    with GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        grasps = client.sample_grasps(object_name, count)
        goal = client.start_evaluation(
            RegisteredObject(object_name),
            find_material("banana").material,
            grasps,
            object_name=object_name,
            on_progress=show_progress,
            on_evaluation=show_evaluation,
        )
        try:
            answer = goal.answer(patience)
        except (TimeoutError, KeyboardInterrupt):
            print("\nthat is enough: canceling")
            goal.cancel()
            answer = goal.answer()
    print(f"\n{answer.code.name}: {answer.message}")
    return answer.code


def main() -> int:
    """Watch; 1 if the evaluator refuses."""
    parser = argparse.ArgumentParser(description="Watch an evaluation, and cancel it when you have seen enough.")
    parser.add_argument("--object", default="strawberry", help="name of an object of the library")
    parser.add_argument("--count", type=int, default=6, help="number of grasps")
    parser.add_argument("--patience", type=float, default=30.0, metavar="S", help="time after which it is canceled")
    arguments = parser.parse_args()
    try:
        watch(arguments.object, arguments.count, arguments.patience)
    except DefgraspError as error:
        print(f"{error.code.name}: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
