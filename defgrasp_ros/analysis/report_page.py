"""The report of a run: one HTML page that needs nothing else, with tables, pictures and charts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from defgrasp_ros.analysis.charts import course_chart, direction_chart, squeeze_chart
from defgrasp_ros.analysis.field_notes import field_notes
from defgrasp_ros.analysis.pictures import (
    SMALL_SHAPE,
    direction_picture,
    equal_cameras,
    field_picture,
    turned_picture,
)
from defgrasp_ros.analysis.recorded_run import RecordedGrasp, RecordedRun
from defgrasp_ros.analysis.tables import ACCELERATIONS, INTERFACES, TURNS
from defgrasp_ros.color_scales import acceleration_scale, deformation_scale, round_numbers, stress_scale
from defgrasp_ros.errors import InvalidOptionsError, RecordingError
from defgrasp_ros.evaluation import EvaluationOptions, Experiment, GraspEvaluation
from defgrasp_ros.option import options_of
from defgrasp_ros.report import EXPERIMENT_COLUMNS, FEATURE_COLUMNS, METRIC_COLUMNS
from defgrasp_ros.scene import STAGES, Scene, drawn_stage

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

TEMPLATE = "report.html"
BEST, FAILED = 3, 2
"""Grasps that are shown in detail where there are many: the best ones, the worst that holds, and of the failed ones
those that failed in different ways."""
SHOW_ALL = 6
"""Runs of so many grasps are shown in detail as a whole."""
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
SUPERSCRIPTS = {"^2": "²", "^3": "³"}
GRADIENT_STOPS = 13
TICK_DISTANCE = 9.0
"""Least distance of labels below a scale of colours [% of its length]."""


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


@dataclass(frozen=True)
class ColorBar:
    """A scale of colours with its ticks."""

    title: str
    gradient: str
    """For CSS."""
    ticks: list[tuple[float, str]]
    """Places in percent, and labels."""
    unit: str


@dataclass(frozen=True)
class Figure:
    """A picture or chart with what has to be said about it."""

    svg: Markup
    caption: str
    bar: ColorBar | None = None


@dataclass
class GraspSection:
    """Everything that is shown of one grasp."""

    recorded: RecordedGrasp
    metrics: list[Number]
    features: list[Number]
    forces: list[Number]
    pictures: list[Figure] = dataclasses.field(default_factory=list)
    no_pictures: str = ""
    stability: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    reorientation: dict[str, Any] | None = None
    course: Markup | None = None
    squeeze: Markup | None = None


def write_report(path: Path, run: RecordedRun, grasps: str | None = None) -> None:
    """Write the page of a run.

    Args:
        path: The file.
        run: The run.
        grasps: Which grasps are shown in detail: numbers or ids with commas between them, or ``"all"``; None: all of
            a few, of many the best, the worst and some that failed.

    Raises:
        InvalidOptionsError: If there is no such grasp.
        RecordingError: If the file cannot be written.
    """
    page = render(run, chosen_grasps(run, grasps))
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def render(run: RecordedRun, shown: Sequence[RecordedGrasp]) -> str:
    """Return the page of a run as text, with the grasps of ``shown`` in detail."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("defgrasp_ros.analysis", "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    columns = _columns(run)
    return environment.get_template(TEMPLATE).render(
        run=run,
        facts=_facts(run),
        options=_option_rows(run),
        columns=[
            {"title": TABLE_TITLES[name], "unit": _unit(unit), "meaning": _meaning("GraspMetrics", name)}
            for name, _, _, unit, _ in columns
        ],
        rows=_table_rows(run, columns),
        shown={grasp.index for grasp in shown},
        sections=_Sections(run, shown).sections(),
        feature_meanings=[
            {"title": title, "unit": _unit(unit), "meaning": _meaning("GraspFeatures", name)}
            for name, title, _, unit, _ in FEATURE_COLUMNS
        ],
    )


def chosen_grasps(run: RecordedRun, text: str | None) -> list[RecordedGrasp]:
    """Return the grasps that are shown in detail; arguments and errors as ``write_report``."""
    if text == "all":
        return list(run.grasps)
    if text is None:
        return _remarkable(run)
    by_name = {str(grasp.index): grasp for grasp in run.grasps} | {grasp.id: grasp for grasp in run.grasps}
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in by_name:
            known = ", ".join(grasp.id for grasp in run.grasps[:20])
            raise InvalidOptionsError(
                f"--grasps: there is no grasp '{name}'; the log has numbers 0 to {len(run.grasps) - 1}: {known}"
            )
    return [by_name[name] for name in dict.fromkeys(names)]


def _remarkable(run: RecordedRun) -> list[RecordedGrasp]:
    """Return the best grasps, the worst that holds and some that failed, each in its own way."""
    ranking = sorted(run.held, key=lambda grasp: grasp.evaluation.metrics.max_von_mises_stress)
    failed = [grasp for grasp in run.grasps if grasp not in ranking]
    if len(run.grasps) <= SHOW_ALL:
        return [*ranking, *failed]
    kinds = {grasp.evaluation.code: grasp for grasp in reversed(failed)}
    return [*ranking[:BEST], *ranking[BEST:][-1:], *list(kinds.values())[:FAILED]]


# Numbers


def _columns(run: RecordedRun) -> list[tuple]:
    """Return the metrics that the table shows: those of the pickup, and of the experiments that were done."""
    done = [name for name in EXPERIMENT_COLUMNS if any(getattr(each.evaluation, name) for each in run.grasps)]
    return [*METRIC_COLUMNS, *(EXPERIMENT_COLUMNS[name] for name in done)]


def _table_rows(run: RecordedRun, columns: Sequence[tuple]) -> list[dict[str, Any]]:
    """Return the rows of the table, the grasps that hold first, that with the smallest peak stress at the top."""
    numbers = {grasp.index: [_metric(run, grasp.evaluation, column) for column in columns] for grasp in run.grasps}
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
            "outcome": _outcome(grasp.evaluation),
            "why": _why(grasp.evaluation),
            "force": _format(grasp.evaluation.target_force, ".3g"),
            "numbers": numbers[grasp.index],
        }
        for grasp in run.grasps
    ]
    infinity = math.inf
    return sorted(
        rows,
        key=lambda row: (
            not row["held"],
            value if math.isfinite(value := row["numbers"][0].value) else infinity,
            row["grasp"].index,
        ),
    )


def _metric(run: RecordedRun, evaluation: GraspEvaluation, column: tuple) -> Number:
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
        unit=_unit(unit),
        text=_format(value * factor, style),
        meaning=_meaning("GraspMetrics", name),
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
        asked = experiment in run.options.get("experiments", [])
        return "the experiment has no result" if asked else "the experiment was not asked for"
    count = sum(map(bool, result.reasons))
    first = next(filter(None, result.reasons), "")
    return f"{count} of {len(result.reasons)} directions have no number; the first: {first}"


def _features(evaluation: GraspEvaluation) -> list[Number]:
    numbers = []
    for name, title, factor, unit, style in FEATURE_COLUMNS:
        value = getattr(evaluation.features, name)
        missing = "" if math.isfinite(value) else evaluation.message
        text, meaning = _format(value * factor, style), _meaning("GraspFeatures", name)
        numbers.append(Number(name, title, _unit(unit), text, meaning, missing, value))
    return numbers


def _forces(evaluation: GraspEvaluation) -> list[Number]:
    columns = (
        ("target_force", "target force", 1.0, "N", ".3g"),
        ("applied_force", "applied force", 1.0, "N", ".3g"),
        ("slip_distance", "slip", 1e3, "mm", ".2f"),
        ("holding_time", "held for", 1.0, "s", ".2f"),
        ("stress_error", "stress error", 1e-3, "kPa", ".2f"),
        ("deformation_error", "deformation error", 1e3, "mm", ".2f"),
    )
    numbers = []
    for name, title, factor, unit, style in columns:
        value = getattr(evaluation, name)
        estimate = name.endswith("_error")
        if estimate and not math.isfinite(value):
            continue  # an estimate that was not made is no news
        missing = "" if math.isfinite(value) else evaluation.message
        text, meaning = _format(value * factor, style), _meaning("GraspEvaluation", name)
        numbers.append(Number(name, title, unit, text, meaning, missing, value))
    return numbers


def _format(value: float, style: str) -> str:
    return format(value, style) if math.isfinite(value) else ""


def _meaning(message: str, name: str) -> str:
    return field_notes(f"{INTERFACES}/{message}")[name].meaning


def _unit(unit: str) -> str:
    for plain, raised in SUPERSCRIPTS.items():
        unit = unit.replace(plain, raised)
    return "" if unit == "-" else unit.replace("deg", "°")


def _outcome(evaluation: GraspEvaluation) -> str:
    if evaluation.metrics.pickup_success:
        return "held"
    return evaluation.code.name.lower().replace("_", " ")


# Facts


def _facts(run: RecordedRun) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return what is known of the run as groups of labels and texts."""
    material, model = run.material, run.model
    groups = [
        (
            "Object",
            [("name", run.object_name)]
            + (
                [
                    ("size", " × ".join(f"{1e3 * side:.3g}" for side in model.mesh.extents) + " mm"),
                    ("mass", f"{1e3 * model.mass:.4g} g"),
                    ("mesh", f"{len(model.mesh.vertices)} nodes, {len(model.mesh.tetrahedra)} tetrahedra"),
                    ("element order", str(model.mesh.element_order)),
                ]
                if model
                else [("mesh", "not in the log")]
            ),
        ),
        (
            "Material",
            [
                ("Young's modulus", _engineering(material.youngs_modulus, "Pa")),
                ("Poisson's ratio", f"{material.poissons_ratio:g}"),
                ("density", f"{material.density:g} kg/m³"),
                ("friction coefficient", f"{material.friction_coefficient:g}"),
            ],
        ),
        (
            "Run",
            [
                ("gripper", run.gripper_name or "unknown"),
                ("experiments", ", ".join(name.replace("_", " ") for name in run.options.get("experiments", []))),
                ("device", run.provenance.get("device", "unknown")),
                ("start", f"{datetime.fromtimestamp(run.start_time / 1e9).astimezone():%Y-%m-%d %H:%M:%S %Z}"),
                ("wall time", f"{run.wall_time:.1f} s"),
                ("versions", ", ".join(f"{name} {text}" for name, text in run.versions.items()) or "unknown"),
            ],
        ),
    ]
    return groups


def _option_rows(run: RecordedRun) -> list[tuple[str, str, str]]:
    """Return name, value with unit and meaning of every constant of the protocol that was in force."""
    known = options_of(EvaluationOptions)
    rows = []
    for name, value in run.options.items():
        option = known.get(name)
        if option is None:
            continue
        text = ("yes" if value else "no") if isinstance(value, bool) else f"{value:g} {_unit(option.unit)}"
        rows.append((name, text.strip(), option.meaning))
    return rows


def _engineering(value: float, unit: str) -> str:
    from matplotlib.ticker import EngFormatter

    return EngFormatter(unit)(value)


# Sections


class _Sections:
    """Makes the sections of the grasps that are shown in detail; all their pictures have the same scales."""

    def __init__(self, run: RecordedRun, shown: Sequence[RecordedGrasp]) -> None:
        self.run, self.shown = run, list(shown)
        drawable = [grasp for grasp in shown if run.model is not None and grasp.grasp is not None]
        self.scenes = {
            grasp.index: Scene.of_evaluation(run.model, run.gripper, grasp.grasp, grasp.evaluation)
            for grasp in drawable
            if drawn_stage(grasp.evaluation)
        }
        self.deformations = {
            grasp.index: self._deformation(grasp, scene.state.positions)
            for grasp in drawable
            if (scene := self.scenes.get(grasp.index)) and "pre_contact" in grasp.evaluation.fields
        }
        self.stress = stress_scale(scene.nodal_stress for scene in self.scenes.values())
        self.deformation = deformation_scale(self.deformations.values())
        self.cameras = dict(zip(self.scenes, equal_cameras(list(self.scenes.values())), strict=True))
        self.accelerations = {
            experiment: acceleration_scale(
                np.concatenate(
                    [np.empty(0), *(result.at_loss for each in shown if (result := self._of(each, experiment)))]
                )
            )
            for experiment in ACCELERATIONS
        }

    def sections(self) -> list[GraspSection]:
        """Return a section per grasp."""
        return [self._section(grasp) for grasp in self.shown]

    def _section(self, grasp: RecordedGrasp) -> GraspSection:
        evaluation = grasp.evaluation
        return GraspSection(
            recorded=grasp,
            metrics=[_metric(self.run, evaluation, column) for column in _columns(self.run)],
            features=_features(evaluation),
            forces=_forces(evaluation),
            pictures=self._pictures(grasp),
            no_pictures=self._why_no_pictures(grasp),
            stability=[stability for name in ACCELERATIONS if (stability := self._stability(grasp, name))],
            reorientation=self._reorientation(grasp),
            course=course_chart(grasp.course),
            squeeze=squeeze_chart(evaluation.squeeze) if evaluation.squeeze else None,
        )

    def _pictures(self, grasp: RecordedGrasp) -> list[Figure]:
        scene, evaluation = self.scenes.get(grasp.index), grasp.evaluation
        if scene is None:
            return []
        camera, when = self.cameras[grasp.index], STAGES[drawn_stage(evaluation)]
        colors = self.stress.to_rgba(scene.nodal_stress)[:, :3]
        caption = f"Von Mises stress {when}, mean at the nodes. Arrows: forces of the contact points on the object."
        figures = [
            Figure(
                field_picture(scene, camera, colors, evaluation.contacts or (), f"Stress of grasp {grasp.id}"),
                caption,
                color_bar("von Mises stress", self.stress, 1e-3, "kPa"),
            )
        ]
        if grasp.index in self.deformations:
            colors = self.deformation.to_rgba(self.deformations[grasp.index])[:, :3]
            caption = f"Deformation {when}: displacement from the shape before contact, rigid motion removed."
            figures.append(
                Figure(
                    field_picture(scene, camera, colors, (), f"Deformation of grasp {grasp.id}"),
                    caption,
                    color_bar("deformation", self.deformation, 1e3, "mm"),
                )
            )
        return figures

    def _why_no_pictures(self, grasp: RecordedGrasp) -> str:
        if grasp.index in self.scenes:
            return ""
        if self.run.model is None:
            return "No pictures: the log does not hold the object's tetrahedra."
        if grasp.evaluation.fields:
            return f"No pictures: the object was not grasped. {grasp.evaluation.message.capitalize()}."
        return "No pictures: the log holds no fields over the mesh for this grasp."

    def _stability(self, grasp: RecordedGrasp, experiment: Experiment) -> dict[str, Any] | None:
        result, scale = self._of(grasp, experiment), self.accelerations[experiment]
        if result is None or scale is None:
            return None
        linear = experiment == Experiment.LINEAR_ACCELERATION
        unit, name = _unit(ACCELERATIONS[experiment]), "linear" if linear else "angular"
        picture = None
        scene = self.scenes.get(grasp.index)
        if scene is not None:
            label = f"{name.capitalize()} acceleration at loss of contact of grasp {grasp.id} in 16 directions"
            picture = direction_picture(scene, result, scale, label, about=not linear)
        known = result.at_loss[np.isfinite(result.at_loss)]
        return {
            "title": f"{name.capitalize()} acceleration at loss of contact",
            "picture": picture,
            "bar": color_bar(f"{name} acceleration at loss of contact", scale, 1.0, unit),
            "chart": direction_chart(result, scale, unit),
            "bounds": int(result.is_lower_bound.sum()),
            "count": len(result.at_loss),
            "missing": [reason for reason in dict.fromkeys(result.reasons) if reason],
            "missing_count": sum(map(bool, result.reasons)),
            "range": f"{known.min():.3g} to {known.max():.3g} {unit}" if len(known) else "",
            "about": not linear,
        }

    def _reorientation(self, grasp: RecordedGrasp) -> dict[str, Any] | None:
        result = grasp.evaluation.reorientation
        if result is None:
            return None
        values = 1e3 * result.max_deformation
        finite = values[np.isfinite(values)]
        scale = tints(finite)
        rows = [
            {
                "turn": angle,
                "cells": [self._cell(values[axis, turn], scale, result.reasons[axis]) for axis in range(len(values))],
            }
            for turn, angle in enumerate(TURNS)
        ]
        return {
            "rows": rows,
            "axes": range(len(values)),
            "force": f"{result.closing_force:.3g}",
            "pictures": self._turned_pictures(grasp),
            "range": f"{finite.min():.3g} to {finite.max():.3g} mm" if len(finite) else "",
        }

    def _cell(self, value: float, scale: Callable[[float], str], reason: str) -> dict[str, str]:
        if not math.isfinite(value):
            return {"text": "", "style": "", "title": f"not measured: {reason}"}
        return {"text": f"{value:.2f}", "style": scale(value), "title": ""}

    def _turned_pictures(self, grasp: RecordedGrasp) -> list[Figure]:
        """Return the four turns about the axis with the largest deformation, as they hang in the world."""
        from scipy.spatial.transform import Rotation

        result = grasp.evaluation.reorientation
        if grasp.index not in self.deformations or not result.states:
            return []
        axis = int(np.nanargmax(np.nanmax(np.nan_to_num(result.max_deformation, nan=-1.0), axis=1)))
        turns = [turn for turn in range(len(TURNS)) if (axis, turn) in result.states]
        scenes = [
            Scene(
                self.run.model,
                self.run.gripper,
                grasp.grasp,
                result.states[axis, turn],
                turn=Rotation.from_rotvec(np.radians(TURNS[turn]) * result.directions[axis]).as_matrix(),
            )
            for turn in turns
        ]
        figures = []
        for turn, scene, camera in zip(turns, scenes, equal_cameras(scenes, SMALL_SHAPE), strict=True):
            colors = self.deformation.to_rgba(self._deformation(grasp, scene.state.positions))[:, :3]
            label = f"Grasp {grasp.id} turned by {TURNS[turn]} degrees about axis {axis}"
            caption = f"axis {axis}, {TURNS[turn]}°: {1e3 * result.max_deformation[axis, turn]:.2f} mm"
            figures.append(Figure(turned_picture(scene, camera, colors, label), caption))
        return figures

    def _deformation(self, grasp: RecordedGrasp, positions: np.ndarray) -> np.ndarray:
        """Return how far each node moved from the shape before contact, rigid motion removed [m]."""
        from defgrasp_ros.experiments.metrics import deformation

        before = grasp.evaluation.fields["pre_contact"].positions.astype(float)
        return deformation(before, positions.astype(float), self.run.mesh.node_volumes)

    @staticmethod
    def _of(grasp: RecordedGrasp, experiment: Experiment) -> Any:
        return getattr(grasp.evaluation, experiment)


def tints(values: np.ndarray) -> Callable[[float], str]:
    """Return a function from a value to the CSS of a cell with a tint of that strength."""
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    width = max(high - low, 1e-12)
    return lambda value: f"--tint:{8 + 72 * (value - low) / width:.0f}%"


def color_bar(title: str, scale: ScalarMappable, factor: float, unit: str) -> ColorBar:
    """Return a scale for the page; ``factor`` turns its values into ``unit``."""
    low, high = scale.norm.vmin, scale.norm.vmax
    places = np.linspace(0.0, 1.0, GRADIENT_STOPS)
    stops = [scale.to_rgba(float(scale.norm.inverse(place)), bytes=True) for place in places]
    gradient = ", ".join(f"#{r:02x}{g:02x}{b:02x}" for r, g, b, _ in stops)
    values = [low, *round_numbers(max(low, high / 12.0), high)] if low == 0.0 else np.linspace(low, high, 4)
    ticks = [(100.0 * float(scale.norm(value)), f"{value * factor:.3g}") for value in values]
    spaced = [ticks[0]]
    for tick in (*ticks[1:], (100.0, f"{high * factor:.2g}")):
        if tick[0] - spaced[-1][0] > TICK_DISTANCE:
            spaced.append(tick)
    return ColorBar(title, gradient, spaced, unit)
