"""Evaluations as a JSON document and as tables for people.

The document uses the names of the messages in ``defgrasp_interfaces``, SI units, and null for what was not measured.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from defgrasp_ros.evaluation import (
    AccelerationResult,
    EvaluationOptions,
    Experiment,
    FingerContact,
    GraspEvaluation,
    ReorientationResult,
    SqueezeResult,
    in_order,
)
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import ObjectModel

FEATURE_COLUMNS = (
    ("contact_patch_distance", "patch dist", 1e3, "mm", ".1f"),
    ("contact_patch_perpendicular_distance", "perp dist", 1e3, "mm", ".1f"),
    ("contact_count", "contacts", 1.0, "-", ".1f"),
    ("edge_distance", "edge dist", 1e3, "mm", ".1f"),
    ("squeeze_distance", "squeeze", 1e3, "mm", ".2f"),
    ("gripper_separation", "separation", 1e3, "mm", ".1f"),
    ("gravity_alignment", "gravity", 180.0 / math.pi, "deg", ".0f"),
)
METRIC_COLUMNS = (
    ("max_von_mises_stress", "max stress", 1e-3, "kPa", ".2f"),
    ("max_deformation", "max deform.", 1e3, "mm", ".2f"),
    ("strain_energy", "strain energy", 1e3, "mJ", ".3g"),
)
"""Metrics of the pickup."""
EXPERIMENT_COLUMNS = {
    Experiment.REORIENTATION: ("deformation_controllability", "max deform. turned", 1e3, "mm", ".2f"),
    Experiment.LINEAR_ACCELERATION: ("linear_instability", "linear instab.", 1.0, "m/s^2", ".3g"),
    Experiment.ANGULAR_ACCELERATION: ("angular_instability", "angular instab.", 1.0, "rad/s^2", ".3g"),
}
"""The metric of each other experiment that has one; the experiment's value is its name in an evaluation, too."""


def document(
    model: ObjectModel, options: EvaluationOptions, device: str, evaluations: list[GraspEvaluation]
) -> dict[str, Any]:
    """Return everything about a run as plain JSON types."""
    return {
        "object": object_document(model),
        "material": dataclasses.asdict(model.material),
        "options": {**dataclasses.asdict(options), "experiments": in_order(options.experiments)},
        "device": device,
        "evaluations": [evaluation_document(evaluation) for evaluation in evaluations],
    }


def object_document(model: ObjectModel) -> dict[str, Any]:
    """Return what is known of the object: counts, [m], [m^3], [kg]."""
    return {
        "name": model.name,
        "vertices": len(model.mesh.vertices),
        "tetrahedra": len(model.mesh.tetrahedra),
        "element_order": model.mesh.element_order,
        "volume": model.mesh.volume,
        "mass": model.mass,
        "extents": model.mesh.extents.tolist(),
        "center_of_mass": model.centroid.tolist(),
    }


def evaluation_document(evaluation: GraspEvaluation) -> dict[str, Any]:
    """Return one evaluation, without its fields."""
    return _plain(
        {
            "grasp_index": evaluation.grasp_index,
            "grasp_id": evaluation.grasp_id,
            "result": {"code": int(evaluation.code), "name": evaluation.code.name, "message": evaluation.message},
            "features": dataclasses.asdict(evaluation.features),
            "metrics": dataclasses.asdict(evaluation.metrics),
            "target_force": evaluation.target_force,
            "applied_force": evaluation.applied_force,
            "contacts": [_finger_document(finger) for finger in evaluation.contacts or ()],
            "palm_force": evaluation.palm_force,
            "slip_distance": evaluation.slip_distance,
            "holding_time": evaluation.holding_time,
            "loss_of_contact_time": evaluation.loss_of_contact_time,
            "simulated_time": evaluation.simulated_time,
            "wall_time": evaluation.wall_time,
            "solver": dataclasses.asdict(evaluation.solver),
            "stress_error": evaluation.stress_error,
            "deformation_error": evaluation.deformation_error,
            "pickup": evaluation.pickup and vars(evaluation.pickup),
            "reorientation": _reorientation_document(evaluation.reorientation),
            "linear_acceleration": _acceleration_document(evaluation.linear_acceleration),
            "angular_acceleration": _acceleration_document(evaluation.angular_acceleration),
            "squeeze": _squeeze_document(evaluation.squeeze),
        }
    )


def _reorientation_document(result: ReorientationResult | None) -> dict[str, Any] | None:
    return result and {name: value for name, value in vars(result).items() if name != "states"}


def _acceleration_document(result: AccelerationResult | None) -> dict[str, Any] | None:
    return result and vars(result)


def _squeeze_document(result: SqueezeResult | None) -> dict[str, Any] | None:
    """The contacts of each force that was reached are left and right finger."""
    if result is None:
        return None
    contacts = [[_finger_document(finger) for finger in fingers] for fingers in result.contacts]
    return {**{name: value for name, value in vars(result).items() if name != "states"}, "contacts": contacts}


def _finger_document(finger: FingerContact) -> dict[str, Any]:
    return {
        "name": finger.name,
        "force": finger.forces.sum(axis=0),
        "normal_force": finger.normal_force,
        "tangential_force": finger.tangential_force,
        "centroid": finger.centroid,
        "count": finger.count,
        "slipping": finger.slipping,
    }


def _plain(value: Any) -> Any:
    """Arrays as lists, numbers that are not finite as None."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(entry) for entry in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def material_text(material: Material) -> str:
    """Return the material in one line."""
    return (
        f"E = {material.youngs_modulus:.3g} Pa, nu = {material.poissons_ratio:g}, "
        f"density = {material.density:g} kg/m^3, mu = {material.friction_coefficient:g}"
    )


def evaluation_table(evaluations: list[GraspEvaluation]) -> Table:
    """Return a table with outcome and metrics of each grasp; ``>=`` marks a lower bound.

    A column that belongs to an experiment is there if it was done with at least one grasp.
    """
    done = [name for name in EXPERIMENT_COLUMNS if any(getattr(each, name) for each in evaluations)]
    table = _table("outcome", (*METRIC_COLUMNS, *(EXPERIMENT_COLUMNS[name] for name in done)))
    for evaluation in evaluations:
        color = "green" if evaluation.metrics.pickup_success else "red"
        numbers = [_number(evaluation.metrics, column) for column in METRIC_COLUMNS]
        numbers += [
            _bound(getattr(evaluation, name)) + _number(evaluation.metrics, EXPERIMENT_COLUMNS[name]) for name in done
        ]
        table.add_row(evaluation.grasp_id, f"[{color}]{evaluation.code.name}[/]", *numbers)
    return table


def feature_table(evaluations: list[GraspEvaluation]) -> Table:
    """Return a table with target force and features of each grasp."""
    table = _table("force\nN", FEATURE_COLUMNS)
    for evaluation in evaluations:
        numbers = [_number(evaluation.features, column) for column in FEATURE_COLUMNS]
        table.add_row(evaluation.grasp_id, _cell(evaluation.target_force, ".3g"), *numbers)
    return table


def _table(second: str, columns: tuple) -> Table:
    """Return a table without rows, narrow enough for a terminal."""
    table = Table(header_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("grasp", no_wrap=True)
    table.add_column(second, no_wrap=True)
    for _, title, _, unit, _ in columns:
        table.add_column(f"{title}\n{unit}", justify="right")
    return table


def reasons(evaluation: GraspEvaluation) -> list[str]:
    """Return why numbers of an evaluation are missing, a line for each cause; empty if none is."""
    if evaluation.metrics.pickup_success:
        return list(_reasons_of_experiments(evaluation))
    return [evaluation.message, *_reasons_of_experiments(evaluation)]


def _reasons_of_experiments(evaluation: GraspEvaluation) -> Iterator[str]:
    for name in EXPERIMENT_COLUMNS:
        result = getattr(evaluation, name)
        if result:
            for reason, count in Counter(filter(None, result.reasons)).items():
                noun = "axes" if name == Experiment.REORIENTATION else "directions"
                yield f"{_spoken(name)}, {count} of {len(result.reasons)} {noun}: {reason}"
    if evaluation.squeeze and evaluation.squeeze.reason:
        yield f"{_spoken(Experiment.SQUEEZE)} {evaluation.squeeze.reason}"


def _spoken(experiment: Experiment) -> str:
    return experiment.value.replace("_", " ")


def _bound(result: AccelerationResult | ReorientationResult | None) -> str:
    """Return a mark for a mean in which at least one direction kept contact up to the end of its test."""
    is_bound = isinstance(result, AccelerationResult) and result.is_lower_bound.any() and not any(result.reasons)
    return ">=" if is_bound else ""


def _number(values: object, column: tuple) -> str:
    name, _, factor, _, style = column
    return _cell(getattr(values, name) * factor, style)


def _cell(value: float, style: str) -> str:
    return format(value, style) if math.isfinite(value) else "-"
