"""A run as tables for spreadsheets and data frames: SI units in the heads, empty cells for what was not measured."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from defgrasp_ros.analysis.field_notes import field_notes
from defgrasp_ros.analysis.recorded_run import PICKUP_FIELDS, RecordedGrasp, RecordedRun
from defgrasp_ros.errors import RecordingError
from defgrasp_ros.evaluation import Experiment
from defgrasp_ros.ros.result_conversion import NUMBERS

INTERFACES = "defgrasp_interfaces/msg"
ACCELERATIONS = {Experiment.LINEAR_ACCELERATION: "m/s^2", Experiment.ANGULAR_ACCELERATION: "rad/s^2"}
"""Experiments with an acceleration per direction, and its unit."""
TURNED = {
    "max_deformation": "m",
    "max_deformation_from_lifted": "m",
    "max_von_mises_stress": "Pa",
    "strain_energy": "J",
}
"""What is known of each state of the reorientation, and its unit."""
TURNS = (45, 90, 135, 180)
"""Angles about an axis [deg]."""
DIRECTION_COUNT = 16

Row = dict[str, Any]


def write_tables(folder: Path, run: RecordedRun) -> list[Path]:
    """Write ``grasps.csv``, ``directions.csv``, ``time_series.csv`` and, where recorded, ``pickup.csv``.

    Args:
        folder: Made if it is not there.
        run: The run.

    Returns:
        The files.

    Raises:
        RecordingError: If they cannot be written.
    """
    tables = {
        "grasps.csv": [grasp_row(grasp) for grasp in run.grasps],
        "directions.csv": [row for grasp in run.grasps for row in direction_rows(grasp)],
        "time_series.csv": [row for grasp in run.grasps for row in sample_rows(grasp)],
        "pickup.csv": [row for grasp in run.grasps for row in pickup_rows(grasp)],
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_write(folder / name, rows) for name, rows in tables.items() if rows]
    except OSError as error:
        raise RecordingError(f"cannot write tables into {folder}: {error.strerror}") from error


def grasp_row(recorded: RecordedGrasp) -> Row:
    """Return everything that is one value per grasp."""
    evaluation = recorded.evaluation
    row = {**_identity(recorded), "code": int(evaluation.code), "outcome": evaluation.code.name}
    row["message"] = evaluation.message
    position = recorded.grasp.position if recorded.grasp else np.full(3, np.nan)
    orientation = recorded.grasp.orientation if recorded.grasp else np.full(4, np.nan)
    row |= {f"position_{axis} [m]": value for axis, value in zip("xyz", position, strict=True)}
    row |= {f"orientation_{axis} [-]": value for axis, value in zip("xyzw", orientation, strict=True)}
    row |= _with_units("GraspEvaluation", {name: getattr(evaluation, name) for name in NUMBERS})
    row |= _with_units("GraspMetrics", dataclasses.asdict(evaluation.metrics))
    return row | _with_units("GraspFeatures", dataclasses.asdict(evaluation.features))


def direction_rows(recorded: RecordedGrasp) -> Iterator[Row]:
    """Yield what is one value per direction of the accelerations, and per axis of the reorientation."""
    evaluation = recorded.evaluation
    results = [getattr(evaluation, name) for name in (*ACCELERATIONS, Experiment.REORIENTATION)]
    directions = next((result.directions for result in results if result), None)
    if directions is None:
        return
    for index, direction in enumerate(directions):
        row = {**_identity(recorded), "direction": index}
        row |= {f"direction_{axis} [-]": value for axis, value in zip("xyz", direction, strict=True)}
        for experiment, unit in ACCELERATIONS.items():
            result, name = getattr(evaluation, experiment), experiment.value
            row[f"{name}_at_loss [{unit}]"] = result.at_loss[index] if result else math.nan
            row[f"{name}_at_slip [{unit}]"] = result.at_slip[index] if result else math.nan
            row[f"{name}_is_lower_bound"] = bool(result.is_lower_bound[index]) if result else ""
            row[f"{name}_reason"] = result.reasons[index] if result else ""
        turned = evaluation.reorientation
        for name, unit in TURNED.items():
            for turn, angle in enumerate(TURNS):
                value = getattr(turned, name)[index, turn] if turned else math.nan
                row[f"reorientation_{name}_{angle}deg [{unit}]"] = value
        row["reorientation_reason"] = turned.reasons[index] if turned else ""
        yield row


def sample_rows(recorded: RecordedGrasp) -> Iterator[Row]:
    """Yield what was published while the grasp was simulated; time since the start of the run."""
    return _rows_over_time(recorded, recorded.samples)


def pickup_rows(recorded: RecordedGrasp) -> Iterator[Row]:
    """Yield the pickup over time as the evaluation has it; time since the start of the squeeze."""
    return _rows_over_time(recorded, recorded.pickup) if recorded.pickup else iter(())


def _rows_over_time(recorded: RecordedGrasp, series) -> Iterator[Row]:
    units = field_notes(f"{INTERFACES}/PickupCourse")
    names = [name for name in PICKUP_FIELDS if name in series.values]
    for index, time in enumerate(series.time):
        row = {**_identity(recorded), "time [s]": time}
        yield row | {f"{name} [{units[name].unit}]": series.values[name][index] for name in names}


def _identity(recorded: RecordedGrasp) -> Row:
    return {"grasp_index": recorded.index, "grasp_id": recorded.id}


def _with_units(message: str, values: Row) -> Row:
    notes = field_notes(f"{INTERFACES}/{message}")
    heads = {name: f"{name} [{notes[name].unit}]" if notes[name].unit else name for name in values}
    return {heads[name]: value for name, value in values.items()}


def _write(path: Path, rows: list[Row]) -> Path:
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows({head: _cell(value) for head, value in row.items()} for row in rows)
    return path


def _cell(value: Any) -> Any:
    if isinstance(value, (bool, np.bool_)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return repr(float(value)) if math.isfinite(value) else ""
    return value
