"""Pictures of evaluated grasps: the deformed object, coloured by stress, between the fingers."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defgrasp_ros.drawing.color_scales import AXIS_COLORS, FORCE_COLOR, TEXT_COLOR, round_numbers, stress_scale
from defgrasp_ros.drawing.rendering import Camera, compose, downsample
from defgrasp_ros.drawing.scene import SOFTNESS, STAGES, SUPERSAMPLING, Scene, drawn_stage
from defgrasp_ros.evaluation import GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.report import FEATURE_COLUMNS, METRIC_COLUMNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

MAX_PANELS = 100
"""Grasps on one contact sheet."""

PANEL_PIXELS, LARGE_PANEL_PIXELS = 420, 1000
PANEL_SIZE, CAPTION, HEAD, FOOT, MIN_SHEET_WIDTH = 2.9, 0.55, 0.85, 1.25, 6.6
"""Layout of the contact sheet [inch]."""
LEGEND_CHARACTER = 0.066
"""Mean width of a character of the legend [inch]."""
DPI = 150

CAPTION_COLUMNS = [(name, title.replace("max", "peak"), *rest) for name, title, *rest in METRIC_COLUMNS[:2]]
"""What stands below a panel: peak stress and deformation."""
ZOOM_SPREAD = 1.35
"""Panels of a sheet have one scale, but for those that would need so much more room than the others."""

AXIS_NAMES = ("x: pad width", "y: closing", "z: approach")
AXIS_LENGTH, FORCE_LENGTH = 0.25, 0.35
"""Of the axes and of the largest force, in half heights of the picture."""
HELD_COLOR, FAILED_COLOR = "#1b7f3b", "#b3261e"


def draw_evaluation(
    path: Path | str, object_model: ObjectModel, gripper: Gripper, grasp: Grasp, evaluation: GraspEvaluation
) -> None:
    """Draw one grasp after pickup, or at the target force where the pickup failed, and write a PNG.

    Where the evaluation holds no fields (the object was missed, or they were not asked for), object and gripper
    are drawn grey as they are before the grasp.

    Args:
        path: The picture to write.
        object_model: The object.
        gripper: Gives the shape of the fingers.
        grasp: The pose.
        evaluation: What came out; with fields if the options asked for them.
    """
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(11.0, 7.4), dpi=DPI, facecolor="white")
    scene = Scene.of_evaluation(object_model, gripper, grasp, evaluation)
    stress = stress_scale([scene.nodal_stress] if scene.state else [])
    axes = figure.add_axes((0.01, 0.02, 0.66, 0.86))
    camera = scene.camera((LARGE_PANEL_PIXELS, LARGE_PANEL_PIXELS))
    _draw_scene(axes, scene, evaluation, stress, camera, detailed=True)
    title = f"{object_model.name}, grasp {grasp.id}"
    figure.text(0.03, 0.945, title, fontsize=17, weight="bold", va="center", parse_math=False)
    subtitle = f"{_object_text(object_model)};  {_stage_name(evaluation)}"
    figure.text(0.03, 0.905, subtitle, fontsize=10, color=TEXT_COLOR, va="center")
    _write_numbers(figure, 0.70, 0.86, evaluation)
    if stress is not None:
        _add_colorbar(figure, (0.70, 0.075, 0.26, 0.022), stress)
    figure.savefig(path, format="png")


def draw_evaluations(
    path: Path | str,
    object_model: ObjectModel,
    gripper: Gripper,
    grasps: Sequence[Grasp],
    evaluations: Sequence[GraspEvaluation],
) -> None:
    """Draw several grasps of one object side by side, with one scale of stress, and write a PNG.

    Args:
        path: The picture to write.
        object_model: The object.
        gripper: Gives the shape of the fingers.
        grasps: The poses, in the order of the evaluations; of many, the first ``MAX_PANELS`` are drawn.
        evaluations: What came out of each, drawn as in ``draw_evaluation``.
    """
    import matplotlib.figure

    pairs = list(zip(grasps, evaluations, strict=True))
    shown = pairs[:MAX_PANELS]
    scenes = [Scene.of_evaluation(object_model, gripper, grasp, evaluation) for grasp, evaluation in shown]
    stress = stress_scale(scene.nodal_stress for scene in scenes if scene.state)
    cameras = _with_equal_scale([scene.camera((PANEL_PIXELS, PANEL_PIXELS)) for scene in scenes])
    columns = min(len(scenes), max(3, math.ceil(math.sqrt(1.6 * len(scenes)))))
    rows = math.ceil(len(scenes) / columns)
    width = max(PANEL_SIZE * columns, MIN_SHEET_WIDTH)
    height = HEAD + (PANEL_SIZE + CAPTION) * rows + FOOT
    margin = (width - PANEL_SIZE * columns) / 2.0
    figure = matplotlib.figure.Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    for index, (scene, camera, (grasp, evaluation)) in enumerate(zip(scenes, cameras, shown, strict=True)):
        row, column = divmod(index, columns)
        left, bottom = margin + PANEL_SIZE * column, height - HEAD - PANEL_SIZE * (row + 1) - CAPTION * row
        axes = figure.add_axes((left / width, bottom / height, PANEL_SIZE / width, PANEL_SIZE / height))
        _draw_scene(axes, scene, evaluation, stress, camera, detailed=False)
        _write_caption(axes, grasp, evaluation)
    held = sum(evaluation.metrics.pickup_success for _, evaluation in pairs)
    title = f"{object_model.name}: {held} of {len(pairs)} grasps picked up"
    if len(pairs) > MAX_PANELS:
        title += f" (the first {MAX_PANELS} are shown)"
    figure.text(0.2 / width, 1.0 - 0.32 / height, title, fontsize=15, weight="bold", va="center", parse_math=False)
    figure.text(
        0.2 / width, 1.0 - 0.62 / height, _object_text(object_model), fontsize=9.5, color=TEXT_COLOR, va="center"
    )
    _write_legend(figure, width - 0.2, 0.22, width, height)
    if stress is not None:
        length = min(5.0, 0.6 * width)
        _add_colorbar(figure, ((width - length) / 2.0 / width, 0.95 / height, length / width, 0.12 / height), stress)
    figure.savefig(path, format="png")


def _with_equal_scale(cameras: list[Camera]) -> list[Camera]:
    """Return cameras that show things equally large, but for those that must show much more than the others."""
    typical = float(np.median([camera.half_height for camera in cameras]))
    largest = max(camera.half_height for camera in cameras if camera.half_height <= ZOOM_SPREAD * typical)
    return [dataclasses.replace(camera, half_height=max(camera.half_height, largest)) for camera in cameras]


def _draw_scene(
    axes: Axes,
    scene: Scene,
    evaluation: GraspEvaluation,
    stress: ScalarMappable | None,
    camera: Camera,
    detailed: bool,
) -> None:
    """Draw into axes whose coordinates become those of the camera [m]."""
    fine = camera.refined(SUPERSAMPLING)
    colors = stress.to_rgba(scene.nodal_stress)[:, :3] if scene.state else None
    image = downsample(compose(scene.layers(fine, colors), np.ones(3), SOFTNESS * fine.shape[0]), SUPERSAMPLING)
    axes.imshow(image, extent=camera.extent, interpolation="antialiased")
    axes.set_axis_off()
    if scene.state:
        _draw_forces(axes, evaluation, camera, detailed)
    _draw_axes(axes, scene, camera, detailed)
    _draw_scale_bar(axes, camera)


def _draw_forces(axes: Axes, evaluation: GraspEvaluation, camera: Camera, detailed: bool) -> None:
    """Draw the force of each contact point on the object as an arrow that ends at the point, pale if behind it."""
    if not evaluation.contacts:
        return
    positions = np.concatenate([contact.positions for contact in evaluation.contacts])
    forces = np.concatenate([contact.forces for contact in evaluation.contacts])
    if len(forces) == 0:
        return
    normals = np.concatenate([contact.normals for contact in evaluation.contacts])
    is_behind = normals @ camera.rotation[2] > 0.0
    arrows = forces / np.linalg.norm(forces, axis=1).max() * (FORCE_LENGTH * camera.half_height)
    heads, tails = camera.view(positions)[:, :2], camera.view(positions - arrows)[:, :2]
    for head, tail, behind in zip(heads, tails, is_behind, strict=True):
        _draw_arrow(axes, tail, head, FORCE_COLOR, 1.8 if detailed else 1.0, opacity=0.4 if behind else 1.0)


def _draw_axes(axes: Axes, scene: Scene, camera: Camera, detailed: bool) -> None:
    """Draw the grasp frame: x across the pads, y closing, z approach."""
    length = AXIS_LENGTH * camera.half_height
    origin = camera.view(scene.grasp.position)[:2]
    for name, direction, color in zip("xyz", scene.grasp.rotation.T, AXIS_COLORS, strict=True):
        tip = camera.view(scene.grasp.position + length * direction)[:2]
        _draw_arrow(axes, origin, tip, color, 1.6 if detailed else 0.9)
        if detailed:
            label = origin + 1.18 * (tip - origin)
            axes.text(*label, name, color=color, fontsize=10, weight="bold", ha="center", va="center")


def _draw_arrow(axes: Axes, tail: np.ndarray, head: np.ndarray, color: str, width: float, opacity: float = 1.0) -> None:
    """Draw an arrow with a thin light rim, so that it shows on every ground."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.patheffects import Normal, withStroke

    length_in_points = np.linalg.norm(np.diff(axes.transData.transform([tail, head]), axis=0)) * 72.0 / DPI
    arrow = FancyArrowPatch(
        tail,
        head,
        arrowstyle="-|>",
        mutation_scale=min(6.0 * width, length_in_points),
        color=color,
        alpha=opacity,
        linewidth=width,
        shrinkA=0,
        shrinkB=0,
    )
    arrow.set_path_effects([withStroke(linewidth=width + 1.2, foreground="white", alpha=opacity), Normal()])
    axes.add_patch(arrow)


def _draw_scale_bar(axes: Axes, camera: Camera) -> None:
    """Draw a bar of a round length, about a fifth of the picture's width."""
    left, right, bottom, _ = camera.extent
    width = right - left
    length = max(step for step in round_numbers(1e-4, 0.2 * width))
    start, level = left + 0.04 * width, bottom + 0.01 * width
    axes.plot([start, start + length], [level, level], color=TEXT_COLOR, linewidth=1.6, solid_capstyle="butt")
    label = f"{length * 1e3:g} mm"
    axes.text(start + length / 2.0, level + 0.012 * width, label, fontsize=7, color=TEXT_COLOR, ha="center")


def _outcome(evaluation: GraspEvaluation) -> tuple[str, str]:
    """Return the outcome in words and its colour."""
    if evaluation.metrics.pickup_success:
        return "picked up", HELD_COLOR
    return evaluation.code.name.lower().replace("_", " "), FAILED_COLOR


def _number(value: float, factor: float, unit: str, style: str) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value * factor:{style}}" + (f" {unit}" if unit != "-" else "")


def _object_text(model: ObjectModel) -> str:
    """Return mass and material in readable units."""
    from matplotlib.ticker import EngFormatter

    material = model.material
    return (
        f"E = {EngFormatter('Pa')(material.youngs_modulus)},  $\\nu$ = {material.poissons_ratio:g},  "
        f"$\\rho$ = {material.density:g} kg/m$^3$,  $\\mu$ = {material.friction_coefficient:g},  "
        f"mass {EngFormatter('g', places=1)(model.mass * 1e3)}"
    )


def _write_caption(axes: Axes, grasp: Grasp, evaluation: GraspEvaluation) -> None:
    """Write grasp, outcome and metrics below a panel."""
    outcome, color = _outcome(evaluation)
    at = {"transform": axes.transAxes, "ha": "center", "va": "top"}
    axes.text(0.5, 0.0, f"{grasp.id}: {outcome}", color=color, fontsize=10, weight="bold", parse_math=False, **at)
    known = evaluation.metrics.pickup_success
    numbers = [f"{title} {number}" for title, number in _rows(evaluation.metrics, CAPTION_COLUMNS)]
    text = ",  ".join(numbers) if known else f"drawn {_stage_name(evaluation)}"
    axes.text(0.5, -0.08, text, color=TEXT_COLOR, fontsize=8, **at)


def _stage_name(evaluation: GraspEvaluation) -> str:
    """Return what is drawn, in words."""
    stage = drawn_stage(evaluation)
    return STAGES[stage] if stage else "before the grasp"


def _write_legend(figure: Figure, right: float, top: float, width: float, height: float) -> None:
    """Say what the arrows are, in a line that ends at ``right`` [inch], ``top`` inches above the bottom."""
    from matplotlib.patches import FancyArrowPatch

    entries = [("contact force on the object", FORCE_COLOR), *zip(AXIS_NAMES, AXIS_COLORS, strict=True)]
    for text, color in reversed(entries):
        right -= LEGEND_CHARACTER * len(text)
        figure.text(right / width, top / height, text, fontsize=8.5, color=TEXT_COLOR, va="center")
        arrow = {"arrowstyle": "-|>", "mutation_scale": 8, "color": color, "linewidth": 1.5}
        ends = [((right - offset) / width, top / height) for offset in (0.06, 0.28)]
        figure.add_artist(FancyArrowPatch(ends[1], ends[0], transform=figure.transFigure, **arrow))
        right -= 0.45


def _write_numbers(figure: Figure, left: float, top: float, evaluation: GraspEvaluation) -> None:
    """Write outcome, forces, metrics and features as a column of text."""
    outcome, color = _outcome(evaluation)
    badge = {"boxstyle": "round,pad=0.45", "facecolor": color, "edgecolor": "none"}
    figure.text(left + 0.01, top + 0.07, outcome, fontsize=13, weight="bold", color="white", va="center", bbox=badge)
    if not evaluation.metrics.pickup_success:
        message = textwrap.fill(evaluation.message, 44)
        figure.text(
            left, top + 0.025, message, fontsize=9, color=TEXT_COLOR, va="top", linespacing=1.3, parse_math=False
        )
        top -= 0.025 * (message.count("\n") + 1)
    forces = [("target", _number(evaluation.target_force, 1.0, "N", ".3g"))]
    forces.append(("measured", _number(evaluation.applied_force, 1.0, "N", ".3g")))
    groups = [
        ("Force, sum of both pads", forces),
        ("Metrics", _rows(evaluation.metrics, METRIC_COLUMNS)),
        ("Features at the target force", _rows(evaluation.features, FEATURE_COLUMNS)),
    ]
    for title, rows in groups:
        top -= 0.02
        figure.text(left, top, title, fontsize=10.5, weight="bold", va="center")
        for label, number in rows:
            top -= 0.033
            figure.text(left, top, label, fontsize=10, color=TEXT_COLOR, va="center")
            figure.text(0.96, top, number, fontsize=10, va="center", ha="right")
        top -= 0.035


def _rows(values: object, columns: Sequence[tuple]) -> list[tuple[str, str]]:
    return [
        (title, _number(getattr(values, name), factor, unit, style)) for name, title, factor, unit, style in columns
    ]


def _add_colorbar(figure: Figure, bounds: tuple[float, float, float, float], stress: ScalarMappable) -> None:
    """Add a horizontal scale of stress with a readable unit."""
    from matplotlib.ticker import EngFormatter

    bar = figure.colorbar(stress, cax=figure.add_axes(bounds), orientation="horizontal", extend="max")
    bar.set_label("von Mises stress, mean at the nodes", fontsize=9)
    bar.set_ticks([0.0, *round_numbers(stress.norm.vmax / 12.0, stress.norm.vmax)])
    bar.ax.minorticks_off()
    bar.ax.xaxis.set_major_formatter(EngFormatter("Pa"))
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_linewidth(0.5)
