"""Rank grasps by several measures at once, in a given time.

Start the evaluator in one terminal, ``defgrasp_evaluator``, and this in another::

    python examples/rank_grasps.py --mesh banana.stl --material banana --count 20 --time-limit 60

The object is registered once, candidates are sampled on its surface, and those that hold are compared by peak stress
and by deformation. No single number says which is best: printed are those that no other grasp beats in both measures.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from defgrasp_ros.client import GraspEvaluatorClient, MeshFile, RegisteredObject
from defgrasp_ros.errors import DefgraspError
from defgrasp_ros.evaluation import GraspEvaluation
from defgrasp_ros.material_library import find_material

START_TIMEOUT = 60.0
"""How long to wait for an evaluator that is only just being started [s]."""


def costs(evaluation: GraspEvaluation) -> tuple[float, float]:
    """Return what should be small: peak stress [Pa] and largest deformation [m]."""
    return evaluation.metrics.max_von_mises_stress, evaluation.metrics.max_deformation


def unbeaten(evaluations: Sequence[GraspEvaluation]) -> list[GraspEvaluation]:
    """Return the grasps that hold and that no other one beats in every cost, the least stress first."""
    held = [evaluation for evaluation in evaluations if evaluation.metrics.pickup_success]

    def beaten(evaluation: GraspEvaluation) -> bool:
        own = costs(evaluation)
        return any(
            costs(other) != own and all(a <= b for a, b in zip(costs(other), own, strict=True)) for other in held
        )

    return sorted((evaluation for evaluation in held if not beaten(evaluation)), key=costs)


def rank(arguments: argparse.Namespace) -> list[GraspEvaluation]:
    """Ask the evaluator and print the ranking."""
    material = find_material(arguments.material).material
    with GraspEvaluatorClient() as client:
        client.wait_until_ready(START_TIMEOUT)
        name = arguments.object
        if arguments.mesh:
            name = arguments.mesh.stem
            report = client.register_object(MeshFile(arguments.mesh), material, name, replace=True)
            print(
                f"{name}: {report.tetrahedron_count} tetrahedra, {1e3 * report.mass:.0f} g", *report.warnings, sep="\n"
            )
        grasps = client.sample_grasps(name, arguments.count, seed=arguments.seed)
        answer = client.evaluate_grasps(
            RegisteredObject(name), material, grasps, object_name=name, time_limit=arguments.time_limit
        )
    print(answer.message)
    best = unbeaten(answer.evaluations)
    for evaluation in best:
        stress, deformation = costs(evaluation)
        print(f"{evaluation.grasp_id}: peak stress {1e-3 * stress:.3g} kPa, deformation {1e3 * deformation:.3g} mm")
    return best


def main() -> int:
    """Rank; 1 if no grasp holds or the evaluator refuses."""
    parser = argparse.ArgumentParser(description="Rank sampled grasps by stress and deformation.")
    parser.add_argument("--mesh", type=Path, help="mesh file of the object [m]; default: --object")
    parser.add_argument("--object", default="strawberry", help="name of an object of the library")
    parser.add_argument("--material", default="banana", help="name of a material of the library")
    parser.add_argument("--count", type=int, default=8, help="number of grasps")
    parser.add_argument("--seed", type=int, default=0, help="equal seeds give equal grasps")
    parser.add_argument("--time-limit", type=float, default=0.0, metavar="S", help="0: none")
    arguments = parser.parse_args()
    try:
        best = rank(arguments)
    except DefgraspError as error:
        print(f"{error.code.name}: {error}")
        return 1
    if not best:
        print("No grasp holds the object.")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
