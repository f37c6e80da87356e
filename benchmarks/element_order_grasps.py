"""Pickups of the same grasps on meshes of order 1 and 2 with as many nodes, against a finer mesh.

Run: ``python benchmarks/element_order_grasps.py --output results.jsonl [OBJECT ...]`` with names of the library. Every
grasp on every mesh is a line of the output; meshes that are there already are not run again. The tables of
``docs/element_order.md`` are printed at the end, of all lines.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.experiments import evaluate_grasps
from defgrasp_ros.experiments.metrics import von_mises_stress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.node_count import GROWTH, with_nodes
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.objects import hollow
from defgrasp_ros.objects.library import HOLLOWS, LibraryObject, find_object
from defgrasp_ros.sampling import sample_grasps
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS

OBJECTS = ("sphere_flat_base", "cylinder", "banana", "cup_soft")
MATERIAL = Material(2e5)
OPTIONS = EvaluationOptions(pickup_hold_time=0.5, return_fields=True)
GRASPS, CANDIDATES = 3, 6
"""Grasps compared on an object: the first that hold of so many sampled ones."""
BUDGET_SHARES = (0.85, 1.0, 1.15)
"""Meshes of each order, in shares of the nodes of a mesh of order 1: one mesh alone may be lucky [-]."""
REFERENCE_NODES = 3_500
NODE_TOLERANCE, ATTEMPTS = 0.05, 6
"""Relative difference of node counts that counts as none [-]; meshes made to reach it."""
QUANTITIES = {
    "squeeze_distance": ("squeeze", 1e3, "mm"),
    "max_deformation": ("deformation", 1e3, "mm"),
    "strain_energy": ("energy", 1e6, "uJ"),
    "mean_stress": ("mean stress", 1.0, "Pa"),
    "high_stress": ("95 % stress", 1.0, "Pa"),
    "max_von_mises_stress": ("max stress", 1.0, "Pa"),
}
"""Heading, factor to the unit, unit."""


def main() -> None:
    """Run what is missing, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("objects", nargs="*", default=OBJECTS)
    parser.add_argument("--output", type=Path, required=True, help="lines of JSON; is added to")
    parser.add_argument("--reference-nodes", type=int, default=REFERENCE_NODES)
    parser.add_argument("--reference-order", type=int, default=2)
    asked = parser.parse_args()
    for name in asked.objects:
        budget = len(find_object(name).mesh(element_order=1).vertices)
        for share in BUDGET_SHARES:
            run(name, 1, round(share * budget), asked.output)
            run(name, 2, round(share * budget), asked.output)
    for name in asked.objects:
        run(name, asked.reference_order, asked.reference_nodes, asked.output, is_reference=True)
    lines = rows(asked.output)
    print_values(lines)
    print_differences(lines)


def run(name: str, order: int, nodes: int, output: Path, is_reference: bool = False) -> None:
    """Try the grasps of an object on one mesh, unless the output has them already."""
    if any((row["object"], row["order"], row["asked_nodes"]) == (name, order, nodes) for row in rows(output)):
        return
    grasps = held_grasps(name, output)
    mesh = mesh_with_nodes(find_object(name), order, nodes)
    model = ObjectModel(name, mesh, MATERIAL)
    start = time.process_time()
    evaluations = evaluate_grasps(model, grasps, load_gripper(), OPTIONS)
    seconds = (time.process_time() - start) / len(grasps)
    with output.open("a") as file:
        for evaluation in evaluations:
            row = {
                "object": name,
                "order": order,
                "asked_nodes": nodes,
                "nodes": len(mesh.vertices),
                "is_reference": is_reference,
                "grasp": evaluation.grasp_index,
                "outcome": evaluation.code.name,
                "message": evaluation.message,
                "contact_count": evaluation.features.contact_count,
                "squeeze_distance": evaluation.features.squeeze_distance,
                "processor_time": seconds,
            }
            if evaluation.metrics.pickup_success:
                stress, volumes = stresses(model, evaluation.fields["post_pickup"].positions)
                row |= {key: getattr(evaluation.metrics, key) for key in QUANTITIES if hasattr(evaluation.metrics, key)}
                row |= {"mean_stress": np.average(stress, weights=volumes), "high_stress": quantile(stress, volumes)}
                seen = evaluation.fields["post_pickup"].von_mises_stress.max()
                assert abs(stress.max() - seen) < 1e-6 * seen, "stresses are not those of the simulation"
            file.write(json.dumps(row) + "\n")
    codes = ", ".join(evaluation.code.name for evaluation in evaluations)
    print(f"{name}, order {order}, {len(mesh.vertices)} nodes: {codes}; {seconds:.0f} s each", flush=True)


def held_grasps(name: str, output: Path) -> list[Grasp]:
    """Return the first grasps that hold the object's mesh of order 1, with its default force."""
    kept = output.with_suffix(f".{name}.json")
    model = ObjectModel(name, find_object(name).mesh(element_order=1), MATERIAL)
    force = model.default_target_force(OPTIONS.force_safety_factor)
    sampled = sample_grasps(*find_object(name).surface(), load_gripper(), CANDIDATES, seed=1)
    grasps = [replace(grasp, target_force=force) for grasp in sampled]
    if not kept.exists():
        evaluations = evaluate_grasps(model, grasps, load_gripper(), OPTIONS)
        kept.write_text(json.dumps([each.grasp_index for each in evaluations if each.metrics.pickup_success]))
    return [grasps[index] for index in json.loads(kept.read_text())[:GRASPS]]


def mesh_with_nodes(thing: LibraryObject, order: int, nodes: int) -> TetMesh:
    """Return a mesh of an object with about so many nodes."""
    if thing.shape in HOLLOWS:
        usual, hollow.NODES = hollow.NODES, nodes
        mesh = thing.mesh(element_order=order)
        hollow.NODES = usual
        return mesh
    mesh = thing.mesh(element_order=order)
    edge = np.linalg.norm(np.diff(mesh.vertices[mesh.tetrahedra[:, :2]], axis=1), axis=-1).mean()
    edge *= (len(mesh.vertices) / nodes) ** GROWTH
    return with_nodes(lambda edge: thing.mesh(edge, order), edge, order, 1.2, nodes, NODE_TOLERANCE, ATTEMPTS)


def stresses(model: ObjectModel, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the von Mises stress at all stress points [Pa] and the volume of each [m^3]."""
    mesh, reference = model.mesh, REFERENCE_ELEMENTS[model.mesh.element_order]
    gradients = reference.gradients(mesh.shape_gradients)
    deformation = np.einsum("tai,tqaj->tqij", positions[mesh.elements], gradients)
    _, s, vt = np.linalg.svd(deformation)
    strain = np.einsum("tqki,tqk,tqkj->tqij", vt, s - 1.0, vt)
    first, second = model.material.lame_parameters
    stress = 2.0 * second * strain + first * np.trace(strain, axis1=2, axis2=3)[..., None, None] * np.eye(3)
    return von_mises_stress(stress).ravel(), np.repeat(mesh.volumes / reference.point_count, reference.point_count)


def quantile(values: np.ndarray, weights: np.ndarray, share: float = 0.95) -> float:
    """Return the value below which that share of the weight lies."""
    order = np.argsort(values)
    return float(np.interp(share * weights.sum(), np.cumsum(weights[order]), values[order]))


def rows(path: Path) -> list[dict]:
    """Return the lines that a file has so far."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def print_values(lines: list[dict]) -> None:
    """Print the means over the grasps of each mesh."""
    columns = [f"{heading} [{unit}]" for heading, _, unit in QUANTITIES.values()]
    print_head("object", "order", "nodes", "held", *columns, "contacts per pad", "processor time per grasp [s]")
    for group in meshes(lines):
        held = [row for row in group if row["outcome"] == "OK"]
        values = [f"{factor * mean(held, key):.3g}" for key, (_, factor, _) in QUANTITIES.items()]
        cost = f"{group[0]['processor_time']:.0f}"
        print_row(*label(group), f"{len(held)} of {len(group)}", *values, f"{mean(group, 'contact_count'):.0f}", cost)


def print_differences(lines: list[dict]) -> None:
    """Print how far the meshes are from the reference: the finest mesh of order 2; those of the budget together."""
    print_head("object", "order", "nodes", "not held", *(heading for heading, _, _ in QUANTITIES.values()))
    fine = [group for group in meshes(lines) if group[0]["is_reference"]]
    references = {group[0]["object"]: group for group in fine if group[0]["order"] == 2}
    groups: dict[tuple, list[dict]] = {}
    for row in lines:
        groups.setdefault((row["object"], row["is_reference"], row["order"]), []).append(row)
    for (name, _, order), group in sorted(groups.items()):
        if name not in references or group == references[name]:
            continue
        exact = {row["grasp"]: row for row in references[name]}
        nodes = sorted({row["nodes"] for row in group})
        values = []
        for key in QUANTITIES:
            both = [row for row in group if key in row and key in exact[row["grasp"]]]
            errors = np.array([row[key] / exact[row["grasp"]][key] - 1.0 for row in both])
            values.append(f"{errors.mean():+.0%}, {np.sqrt((errors**2).mean()):.0%}")
        lost = sum(row["outcome"] != "OK" for row in group)
        print_row(name, str(order), ", ".join(map(str, nodes)), f"{lost} of {len(group)}", *values)


def meshes(lines: list[dict]) -> list[list[dict]]:
    """Return the lines of each mesh."""
    groups: dict[tuple, list[dict]] = {}
    for row in lines:
        groups.setdefault((row["object"], row["nodes"], row["order"]), []).append(row)
    return [groups[key] for key in sorted(groups, key=lambda key: (key[0], key[2], key[1]))]


def label(group: list[dict]) -> list[str]:
    return [str(group[0][key]) for key in ("object", "order", "nodes")]


def mean(group: list[dict], key: str) -> float:
    return float(np.mean([row[key] for row in group]))


def print_head(*names: str) -> None:
    print()
    print_row(*names)
    print("| --- |" + " ---: |" * (len(names) - 1))


def print_row(*cells: str) -> None:
    print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
