"""Trends that the DefGraspSim paper reports, with coarse meshes: is the direction right, and how strong is it?

Run: ``python benchmarks/trends.py`` (minutes), or with names of the trends. ``docs/trends.md`` has the figures.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation
from defgrasp_ros.experiments import evaluate_grasps
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.objects.library import find_object

HOLD_TIME = 0.5
"""Shorter than the protocol's: what holds so long here rests already [s]."""
BANANA_FORCE = 4.0
"""As in the paper [N]."""
ROD_LENGTH, ROD_SIDE, ROD_FORCE = 0.12, 0.01, 4.0
"""Rod [m], force on it [N]."""
ROD_MATERIAL = Material(2e5, friction_coefficient=1.0)
FROM_ABOVE = Rotation.from_euler("x", np.pi)


def friction(coefficients: Iterable[float] = (0.35, 0.5, 0.7, 1.0)) -> dict[float, GraspEvaluation]:
    """A soft block, held by the same 1.5 N with more and more friction, accelerated along 16 directions.

    Further and faster than in the protocol, so that the hand loses it.
    """
    results, beyond = {}, {"linear_jerk": 4e3, "max_linear_acceleration": 200.0}
    for coefficient in coefficients:
        material = Material(2e5, friction_coefficient=coefficient)
        model = ObjectModel("block", box((0.03, 0.03, 0.03), (3, 3, 3)), material)
        grasp = Grasp(np.zeros(3), FROM_ABOVE.as_quat(), "block", 1.5)
        (results[coefficient],) = evaluated(model, [grasp], {"linear_acceleration"}, **beyond)
    return results


def stiffness(moduli: Iterable[float] = (2e4, 2e5, 2e6, 2e9)) -> dict[float, GraspEvaluation]:
    """A ball, held by the same 1 N, less and less soft."""
    mesh = find_object("sphere").mesh(0.006, element_order=1)
    grasp = Grasp(np.array([0.0, 0.0, 0.02]), FROM_ABOVE.as_quat(), "ball", 1.0)
    return {modulus: evaluated(ObjectModel("ball", mesh, Material(modulus)), [grasp], set())[0] for modulus in moduli}


def banana(places: Iterable[float] = (-0.75, -0.35, 0.0, 0.35, 0.75)) -> dict[float, GraspEvaluation]:
    """A banana, held by 4 N at places from one end (-1) to the other (1), accelerated along 16 directions.

    Further and faster than in the protocol, so that the hand loses it.
    """
    fruit = find_object("banana")
    mesh = fruit.mesh(0.018, element_order=1)
    length, bend = fruit.dimensions["length"], fruit.dimensions["bend"]
    grasps = []
    for place in places:
        angle = place * bend / 2.0
        # The hand closes across the fruit, whose middle line is an arc.
        slice_ = mesh.vertices[np.abs(mesh.vertices[:, 0] - length / bend * np.sin(angle)) < 0.012]
        middle = (slice_.min(axis=0) + slice_.max(axis=0)) / 2.0
        turn = Rotation.from_euler("z", angle) * FROM_ABOVE
        grasps.append(Grasp(middle, turn.as_quat(), f"{place:+g}", BANANA_FORCE))
    model = ObjectModel("banana", mesh, Material(2e6))
    experiments = {"linear_acceleration", "angular_acceleration"}
    beyond = {"max_linear_acceleration": 150.0, "angular_jerk": 4e4, "max_angular_acceleration": 4e3}
    results = evaluated(model, grasps, experiments, **beyond)
    return dict(zip(places, results, strict=True))


def rod(places: Iterable[str] = ("end", "middle")) -> dict[str, tuple[GraspEvaluation, float]]:
    """A slender soft rod, lifted lying: by how much does the line from the hand to its tip sag [degrees]?"""
    mesh = replace(box((ROD_LENGTH, ROD_SIDE, ROD_SIDE), (12, 1, 1)), element_order=2)
    model = ObjectModel("rod", mesh, ROD_MATERIAL)
    results = {}
    for place in places:
        x = 0.01 - ROD_LENGTH / 2.0 if place == "end" else 0.0
        grasp = Grasp(np.array([x, 0.0, 0.0]), FROM_ABOVE.as_quat(), place, ROD_FORCE)
        (evaluation,) = evaluated(model, [grasp], set(), return_fields=True)
        results[place] = evaluation, sag(mesh, evaluation, x + 0.01)
    return results


def sag(mesh: TetMesh, evaluation: GraspEvaluation, root: float) -> float:
    """Angle below the horizontal of the line from the section at the pads' edge to the tip [degrees]."""
    x, positions = mesh.vertices[:, 0], evaluation.fields["post_pickup"].positions
    tip = positions[np.isclose(x, x.max())].mean(axis=0) - positions[np.isclose(x, root)].mean(axis=0)
    return float(np.degrees(np.arctan2(-tip[2], np.hypot(tip[0], tip[1]))))


def evaluated(model: ObjectModel, grasps: list[Grasp], experiments: set[str], **options) -> list[GraspEvaluation]:
    chosen = EvaluationOptions(experiments=experiments, pickup_hold_time=HOLD_TIME, **options)
    return evaluate_grasps(model, grasps, load_gripper(), chosen)


def table(title: str, columns: tuple[str, ...], rows: Iterable[Iterable[object]]) -> Table:
    result = Table(title=title)
    for column in columns:
        result.add_column(column, justify="right")
    for row in rows:
        result.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row))
    return result


def friction_table() -> Table:
    columns = ("friction coefficient", "outcome", "slip, mean [m/s^2]", "loss, mean [m/s^2]", "at the limit")
    return table("the same force, more friction", columns, map(_linear, *zip(*friction().items(), strict=True)))


def stiffness_table() -> Table:
    columns = ("E [Pa]", "outcome", "max stress [Pa]", "max deformation [m]")
    rows = (
        (modulus, each.code.name, each.metrics.max_von_mises_stress, each.metrics.max_deformation)
        for modulus, each in stiffness().items()
    )
    return table("the same force, less soft", columns, rows)


def banana_table() -> Table:
    columns = (
        *("place", "outcome", "slip, mean [m/s^2]", "loss, mean [m/s^2]", "at the limit"),
        *("angular loss, mean [rad/s^2]", "at the limit"),
    )
    rows = ((*_linear(place, each), *_angular(each)) for place, each in banana().items())
    return table("along a banana", columns, rows)


def rod_table() -> Table:
    rows = ((place, each.code.name, angle, 90.0 - angle) for place, (each, angle) in rod().items())
    return table("a soft rod", ("held at", "outcome", "sag [deg]", "sweep of a quarter turn [deg]"), rows)


def _linear(key: object, evaluation: GraspEvaluation) -> tuple:
    result = evaluation.linear_acceleration
    if result is None:
        return key, evaluation.code.name, "-", "-", "-"
    slip = float(np.where(np.isnan(result.at_slip), result.at_loss, result.at_slip).mean())
    return key, evaluation.code.name, slip, result.instability, int(result.is_lower_bound.sum())


def _angular(evaluation: GraspEvaluation) -> tuple:
    result = evaluation.angular_acceleration
    return ("-", "-") if result is None else (result.instability, int(result.is_lower_bound.sum()))


TRENDS: dict[str, Callable[[], Table]] = {
    "friction": friction_table,
    "stiffness": stiffness_table,
    "banana": banana_table,
    "rod": rod_table,
}


if __name__ == "__main__":
    for name in sys.argv[1:] or TRENDS:
        Console().print(TRENDS[name]())
