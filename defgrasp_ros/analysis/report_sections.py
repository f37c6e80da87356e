"""What a report shows of one grasp in detail: numbers, pictures and charts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from defgrasp_ros.analysis.charts import course_chart, direction_chart, squeeze_chart
from defgrasp_ros.analysis.pictures import (
    SMALL_SHAPE,
    direction_picture,
    equal_cameras,
    field_picture,
    turned_picture,
)
from defgrasp_ros.analysis.recorded_run import RecordedGrasp, RecordedRun
from defgrasp_ros.analysis.report_numbers import (
    Number,
    feature_numbers,
    force_numbers,
    metric_columns,
    metric_number,
    outcome_of,
    shown_unit,
)
from defgrasp_ros.analysis.tables import ACCELERATIONS, TURNS
from defgrasp_ros.drawing.color_scales import acceleration_scale, deformation_scale, round_numbers, stress_scale
from defgrasp_ros.drawing.scene import STAGES, Scene, drawn_stage
from defgrasp_ros.evaluation import Experiment

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

GRADIENT_STOPS = 13
TICK_DISTANCE = 9.0
"""Least distance of labels below a scale of colours [% of its length]."""


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
    outcome: str
    metrics: list[Number]
    features: list[Number]
    forces: list[Number]
    pictures: list[Figure] = field(default_factory=list)
    no_pictures: str = ""
    stability: list[dict[str, Any]] = field(default_factory=list)
    reorientation: dict[str, Any] | None = None
    course: Markup | None = None
    squeeze: Markup | None = None


class Sections:
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
            outcome=outcome_of(evaluation),
            metrics=[metric_number(self.run, evaluation, column) for column in metric_columns(self.run)],
            features=feature_numbers(evaluation),
            forces=force_numbers(evaluation),
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
            message = grasp.evaluation.message
            return f"No pictures: the object was not grasped. {message[:1].upper()}{message[1:]}."
        return "No pictures: the log holds no fields over the mesh for this grasp."

    def _stability(self, grasp: RecordedGrasp, experiment: Experiment) -> dict[str, Any] | None:
        result, scale = self._of(grasp, experiment), self.accelerations[experiment]
        if result is None or scale is None:
            return None
        linear = experiment == Experiment.LINEAR_ACCELERATION
        unit, name = shown_unit(ACCELERATIONS[experiment]), "linear" if linear else "angular"
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
