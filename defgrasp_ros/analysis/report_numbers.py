"""The numbers of a report, as a person reads them: value, unit, meaning, and why one is missing."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from defgrasp_ros.analysis.field_notes import field_notes
from defgrasp_ros.analysis.recorded_run import RecordedRun
from defgrasp_ros.analysis.tables import ACCELERATIONS, INTERFACES
from defgrasp_ros.evaluation import Experiment, GraspEvaluation
from defgrasp_ros.report import EXPERIMENT_COLUMNS, FEATURE_COLUMNS, METRIC_COLUMNS

LARGER_IS_BETTER = ("linear_instability", "angular_instability")
NEITHER_IS_BETTER = ("deformation_controllability",)
TABLE_TITLES = {
    "max_von_mises_stress": "peak stress",
    "max_deformation": "deformation",
    "strain_energy": "strain energy",
    "linear_instability": "linear instability",
    "angular_instability": "angular instability",
    "deformation_controllability": "controllability",
}
SHOWN_IF_MEASURED = ("loss_of_contact_time", "stress_error", "deformation_error")
"""A loss that did not happen and an estimate that was not made are no news."""
SUPERSCRIPTS = {"^2": "²", "^3": "³"}


@dataclass(frozen=True)
class Number:
    """A quantity of one grasp, as a person reads it."""

    name: str
    title: str
    unit: str
    """As displayed."""
    text: str
    """With the unit's factor applied; empty where it was not measured."""
    meaning: str
    missing: str = ""
    """Why it was not measured."""
    value: float = math.nan
    """For sorting."""
    share: float = 0.0
    """Of the largest of the run, in [0, 1]."""
    best: bool = False
    bound: bool = False
    """Whether it is a lower bound."""


def metric_columns(run: RecordedRun) -> list[tuple]:
    """Return the metrics that the table shows: those of the pickup, and of the experiments that were done."""
    done = [name for name in EXPERIMENT_COLUMNS if any(getattr(each.evaluation, name) for each in run.grasps)]
    return [*METRIC_COLUMNS, *(EXPERIMENT_COLUMNS[name] for name in done)]


def table_rows(run: RecordedRun, columns: Sequence[tuple]) -> list[dict[str, Any]]:
    """Return the rows of the table, the grasps that hold first, that with the smallest peak stress at the top."""
    numbers = {
        grasp.index: [metric_number(run, grasp.evaluation, column) for column in columns] for grasp in run.grasps
    }
    for place, (name, *_) in enumerate(columns):
        values = np.array([row[place].value for row in numbers.values()])
        if not np.isfinite(values).any():
            continue
        largest = float(np.nanmax(values))
        best = largest if name in LARGER_IS_BETTER else float(np.nanmin(values))
        for row in numbers.values():
            number = row[place]
            is_best = number.value == best and name not in NEITHER_IS_BETTER and np.isfinite(values).sum() > 1
            share = number.value / largest if largest > 0.0 and math.isfinite(number.value) else 0.0
            row[place] = dataclasses.replace(number, share=share, best=is_best)
    rows = [
        {
            "grasp": grasp,
            "held": grasp.evaluation.metrics.pickup_success,
            "outcome": outcome_of(grasp.evaluation),
            "why": _why(grasp.evaluation),
            "force": _format(grasp.evaluation.target_force, ".3g"),
            "numbers": numbers[grasp.index],
        }
        for grasp in run.grasps
    ]
    return sorted(
        rows,
        key=lambda row: (
            not row["held"],
            value if math.isfinite(value := row["numbers"][0].value) else math.inf,
            row["grasp"].index,
        ),
    )


def metric_number(run: RecordedRun, evaluation: GraspEvaluation, column: tuple) -> Number:
    """Return the metric of a column of ``metric_columns``."""
    name, _, factor, unit, style = column
    value = getattr(evaluation.metrics, name)
    experiment = next((key for key, (metric, *_) in EXPERIMENT_COLUMNS.items() if metric == name), None)
    result = getattr(evaluation, experiment) if experiment else None
    bound = experiment in ACCELERATIONS and result is not None and bool(result.is_lower_bound.any())
    missing = ""
    if not math.isfinite(value):
        missing = _why_missing(run, evaluation, experiment)
    return Number(
        name=name,
        title=TABLE_TITLES[name],
        unit=shown_unit(unit),
        text=_format(value * factor, style),
        meaning=meaning_of("GraspMetrics", name),
        missing=missing,
        value=value,
        bound=bound,
    )


def _why(evaluation: GraspEvaluation) -> str:
    """Return why a grasp failed, and which experiments have gaps, in a few words."""
    lines = [] if evaluation.metrics.pickup_success else [evaluation.message]
    for experiment in (*ACCELERATIONS, Experiment.REORIENTATION):
        result = getattr(evaluation, experiment)
        if result and any(result.reasons):
            noun = "axes" if experiment == Experiment.REORIENTATION else "directions"
            missing = sum(map(bool, result.reasons))
            lines.append(f"{experiment.replace('_', ' ')}: {missing} of {len(result.reasons)} {noun} not measured")
    return "; ".join(lines)


def _why_missing(run: RecordedRun, evaluation: GraspEvaluation, experiment: Experiment | None) -> str:
    """Return why a metric has no number."""
    if not evaluation.metrics.pickup_success:
        return evaluation.message or evaluation.code.name
    if experiment is None:
        return "not measured by this evaluator"
    result = getattr(evaluation, experiment)
    if result is None:
        asked = experiment in run.options.experiments
        return "the experiment has no result" if asked else "the experiment was not asked for"
    count = sum(map(bool, result.reasons))
    first = next(filter(None, result.reasons), "")
    return f"{count} of {len(result.reasons)} directions have no number; the first: {first}"


def feature_numbers(evaluation: GraspEvaluation) -> list[Number]:
    """Return the seven features."""
    numbers = []
    for name, title, factor, unit, style in FEATURE_COLUMNS:
        value = getattr(evaluation.features, name)
        missing = "" if math.isfinite(value) else evaluation.message
        text, meaning = _format(value * factor, style), meaning_of("GraspFeatures", name)
        numbers.append(Number(name, title, shown_unit(unit), text, meaning, missing, value))
    return numbers


def force_numbers(evaluation: GraspEvaluation) -> list[Number]:
    """Return forces, slip and time of the hold, and the errors that were estimated."""
    columns = (
        ("target_force", "target force", 1.0, "N", ".3g"),
        ("applied_force", "applied force", 1.0, "N", ".3g"),
        ("slip_distance", "slip", 1e3, "mm", ".2f"),
        ("holding_time", "held for", 1.0, "s", ".2f"),
        ("loss_of_contact_time", "contact lost after", 1.0, "s", ".2f"),
        ("stress_error", "stress error", 1e-3, "kPa", ".2f"),
        ("deformation_error", "deformation error", 1e3, "mm", ".2f"),
    )
    numbers = []
    for name, title, factor, unit, style in columns:
        value = getattr(evaluation, name)
        if name in SHOWN_IF_MEASURED and not math.isfinite(value):
            continue
        missing = "" if math.isfinite(value) else evaluation.message
        text, meaning = _format(value * factor, style), meaning_of("GraspEvaluation", name)
        numbers.append(Number(name, title, unit, text, meaning, missing, value))
    return numbers


def _format(value: float, style: str) -> str:
    return format(value, style) if math.isfinite(value) else ""


def meaning_of(message: str, name: str) -> str:
    """Return what the definition of a message says about a field."""
    return field_notes(f"{INTERFACES}/{message}")[name].meaning


def shown_unit(unit: str) -> str:
    """Return a unit as it is displayed; empty for a pure number."""
    for plain, raised in SUPERSCRIPTS.items():
        unit = unit.replace(plain, raised)
    return "" if unit == "-" else unit.replace("deg", "°")


def outcome_of(evaluation: GraspEvaluation) -> str:
    """Return in a word or two how a grasp ended."""
    if evaluation.metrics.pickup_success:
        return "held"
    return evaluation.code.name.lower().replace("_", " ")
