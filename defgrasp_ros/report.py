"""Evaluations as a JSON document and as a table for people.

The document uses the names of the messages in ``defgrasp_interfaces``, SI units, and null for what was not measured.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from rich.table import Table

from defgrasp_ros.evaluation import EvaluationOptions, FingerContact, GraspEvaluation
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


def document(
    model: ObjectModel, options: EvaluationOptions, device: str, evaluations: list[GraspEvaluation]
) -> dict[str, Any]:
    """Return everything about a run as plain JSON types."""
    return {
        "object": object_document(model),
        "material": dataclasses.asdict(model.material),
        "options": dataclasses.asdict(options) | {"experiments": sorted(options.experiments)},
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
            "slip_distance": evaluation.slip_distance,
            "holding_time": evaluation.holding_time,
            "simulated_time": evaluation.simulated_time,
            "wall_time": evaluation.wall_time,
            "solver": dataclasses.asdict(evaluation.solver),
        }
    )


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
    """Return a table with outcome, the seven features and the metrics of each grasp."""
    table = Table(header_style="bold", pad_edge=False)
    table.add_column("grasp", no_wrap=True)
    table.add_column("outcome", no_wrap=True)
    table.add_column("force\nN", justify="right")
    columns = (*((c, "features") for c in FEATURE_COLUMNS), *((c, "metrics") for c in METRIC_COLUMNS))
    for (_, title, _, unit, _), _ in columns:
        table.add_column(f"{title}\n{unit}", justify="right")
    for evaluation in evaluations:
        held = evaluation.metrics.pickup_success
        outcome = f"[green]{evaluation.code.name}[/]" if held else f"[red]{evaluation.code.name}[/]"
        numbers = [
            _cell(getattr(getattr(evaluation, group), name) * factor, style)
            for (name, _, factor, _, style), group in columns
        ]
        table.add_row(evaluation.grasp_id, outcome, _cell(evaluation.target_force, ".3g"), *numbers)
    return table


def _cell(value: float, style: str) -> str:
    return format(value, style) if math.isfinite(value) else "-"
