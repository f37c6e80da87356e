"""All experiments with many grasps of an object and several stiffnesses: outcomes, ranges of the metrics, cost.

With a material of 1000 kg/m^3, Poisson's ratio 0.3 and friction coefficient 0.7, as in DefGraspSim's study.

Run: ``python benchmarks/all_experiments.py OBJECT --grasps FILE --count 50 --output results.jsonl``, where OBJECT is a
name of the library or a mesh file. Every grasp is a line of the output as soon as its batch is done; what is there
already is not run again, so that a run that was stopped goes on where it was. The table at the end is of all lines;
``--summary FILE`` keeps it as JSON.

An environment is a simulated world: the pickup, each axis of the reorientation, each direction of an acceleration, the
squeeze. It counts as solved if no time step of it was given up and it came to rest where it should.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from defgrasp_ros.commands.object_argument import prepared_object
from defgrasp_ros.evaluation import EvaluationOptions, Experiment, GraspMetrics
from defgrasp_ros.experiments import evaluate_grasps
from defgrasp_ros.grasp_files import read_grasps
from defgrasp_ros.gripper import DEFAULT_GRIPPER, load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.report import evaluation_document

MODULI = (2e4, 2e5, 2e6, 2e9)
"""Young's moduli of the study [Pa]."""
UNSOLVED = ("no solution", "no rest")
"""Reasons of environments that were given up begin so, after where it was."""
DIRECTIONAL = (Experiment.REORIENTATION, Experiment.LINEAR_ACCELERATION, Experiment.ANGULAR_ACCELERATION)
"""Experiments with an environment for each direction."""
METRICS = [name for name in asdict(GraspMetrics()) if name != "pickup_success"]


def main() -> None:
    """Run what is missing, print the table of everything."""
    asked = arguments()
    done = list(rows(asked.output))
    finished = {(row["object"], row["youngs_modulus"], row["evaluation"]["grasp_index"]) for row in done}
    name, prepared, _ = prepared_object(asked.object)
    mesh = prepared.logged()
    grasps = list(enumerate(read_grasps(asked.grasps)))[: asked.count]
    options = EvaluationOptions(experiments=asked.experiments)
    for modulus in asked.youngs_modulus:
        model = ObjectModel(name, mesh, replace(Material(), youngs_modulus=modulus))
        missing = [(index, grasp) for index, grasp in grasps if (name, modulus, index) not in finished]
        for first in range(0, len(missing), asked.batch):
            some = missing[first : first + asked.batch]
            start = time.monotonic()
            evaluations = evaluate_grasps(
                model, [grasp for _, grasp in some], load_gripper(asked.gripper), options, asked.device
            )
            wall = time.monotonic() - start
            for (index, _), evaluation in zip(some, evaluations, strict=True):
                evaluation.grasp_index = index
                row = {
                    "object": name,
                    "nodes": len(mesh.vertices),
                    "youngs_modulus": modulus,
                    "wall_time": wall / len(some),
                    "evaluation": {**evaluation_document(evaluation), "pickup": None},
                }
                done.append(row)
                with asked.output.open("a") as file:
                    file.write(json.dumps(row, allow_nan=False) + "\n")
            left = len(missing) - first - len(some)
            codes = ", ".join(evaluation.code.name for evaluation in evaluations)
            print(f"{name}, E = {modulus:g} Pa: {codes}; {wall:.1f} s, {left} grasps left", flush=True)
    groups = sorted({(row["object"], row["youngs_modulus"]) for row in done})
    summaries = [summary([row for row in done if (row["object"], row["youngs_modulus"]) == group]) for group in groups]
    if asked.summary:
        asked.summary.write_text(json.dumps(summaries, indent=1) + "\n")
    Console(width=160).print(table(summaries))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("object", help="name of the library, or mesh file")
    parser.add_argument("--grasps", type=Path, required=True, help=".json or .h5")
    parser.add_argument("--count", type=int, default=50, help="the first so many grasps of the file")
    parser.add_argument("--youngs-modulus", type=float, nargs="+", default=MODULI, metavar="E", help="[Pa]")
    parser.add_argument("--experiments", default="all")
    parser.add_argument("--batch", type=int, default=4, help="grasps that run together and are kept together")
    parser.add_argument("--gripper", default=DEFAULT_GRIPPER)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--output", type=Path, required=True, help="lines of JSON, one for each grasp; is added to")
    parser.add_argument("--summary", type=Path, help="the table as JSON")
    return parser.parse_args()


def rows(path: Path) -> Iterator[dict]:
    """Yield the lines that a file has so far."""
    if path.exists():
        yield from map(json.loads, path.read_text().splitlines())


def environments(evaluation: dict) -> tuple[int, int]:
    """Return how many environments an evaluation had, and how many of them were not solved."""
    reasons = [evaluation["result"]["message"]]
    for name in DIRECTIONAL:
        if evaluation[name]:
            reasons += evaluation[name]["reasons"]
    if evaluation["squeeze"]:
        reasons.append(evaluation["squeeze"]["reason"])
    return len(reasons), sum(any(text in reason for text in UNSOLVED) for reason in reasons)


def summary(group: list[dict]) -> dict:
    """Return outcomes, ranges and cost of the grasps of one object and stiffness."""
    evaluations = [row["evaluation"] for row in group]
    counts = np.array([environments(evaluation) for evaluation in evaluations]).sum(axis=0)
    values = {
        name: [evaluation["metrics"][name] for evaluation in evaluations if evaluation["metrics"][name] is not None]
        for name in METRICS
    }
    wall = sum(row["wall_time"] for row in group)
    simulated = sum(evaluation["simulated_time"] for evaluation in evaluations)
    return {
        "object": group[0]["object"],
        "nodes": group[0]["nodes"],
        "youngs_modulus": group[0]["youngs_modulus"],
        "grasps": len(group),
        "outcomes": Counter(evaluation["result"]["name"] for evaluation in evaluations),
        "environments": int(counts[0]),
        "unsolved": int(counts[1]),
        "metrics": {
            name: {"count": len(found), "min": min(found), "median": float(np.median(found)), "max": max(found)}
            for name, found in values.items()
            if found
        },
        "wall_time": wall,
        "simulated_time": simulated,
        "wall_time_per_simulated_second": wall / simulated if simulated else None,
    }


def table(summaries: list[dict]) -> Table:
    """Return a table with a column for each object and stiffness."""
    result = Table()
    result.add_column("")
    for each in summaries:
        result.add_column(f"{each['object']}\n{each['youngs_modulus']:g} Pa", justify="right")
    result.add_row("grasps", *(str(each["grasps"]) for each in summaries))
    for outcome in sorted({name for each in summaries for name in each["outcomes"]}):
        result.add_row(outcome, *(str(each["outcomes"].get(outcome, 0)) for each in summaries))
    result.add_row("environments", *(str(each["environments"]) for each in summaries))
    result.add_row("of them solved [%]", *(f"{100 * (1 - e['unsolved'] / e['environments']):.1f}" for e in summaries))
    for name in METRICS:
        result.add_row(name, *(_range(each["metrics"].get(name)) for each in summaries))
    result.add_row("wall time [s]", *(f"{each['wall_time']:.0f}" for each in summaries))
    cost = (each["wall_time_per_simulated_second"] for each in summaries)
    result.add_row("per environment and simulated s [s]", *("-" if each is None else f"{each:.3g}" for each in cost))
    return result


def _range(found: dict | None) -> str:
    return f"{found['min']:.3g} .. {found['median']:.3g} .. {found['max']:.3g}" if found else "-"


if __name__ == "__main__":
    main()
