"""Pictures of evaluated grasps: the deformed object, coloured by stress, between the fingers."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defgrasp_ros.evaluation import GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.rendering import Camera, Layer, compose, downsample, solid, with_outline
from defgrasp_ros.report import FEATURE_COLUMNS, METRIC_COLUMNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

STAGES = {"post_pickup": "after the hold", "at_target_force": "at the target force"}
"""Stages that can be drawn, the first one that there is, and what they are called."""

PLATFORM_STAGE = "at_target_force"
"""The stage in which the object still touches the platform."""

MAX_PANELS = 100
"""Grasps on one contact sheet."""

AZIMUTH, ELEVATION = math.radians(-50.0), math.radians(22.0)
PANEL_PIXELS, LARGE_PANEL_PIXELS = 420, 1000
PANEL_SIZE, CAPTION, HEAD, FOOT, MIN_SHEET_WIDTH = 2.9, 0.55, 0.85, 0.75, 6.0
"""Layout of the contact sheet [inch]."""
SUPERSAMPLING = 2
DPI = 150

STRESS_COLORS, STRESS_COLOR_RANGE = "magma_r", (0.03, 0.86)
"""A colour map from light to dark, without its ends, in which shading would not show."""
STRESS_EXPONENT = 0.5
"""Colour grows with this power of the stress: most of a grasped body bears a small fraction of the peak."""
STRESS_PERCENTILE = 99.5
"""Of the nodes; what lies above has the last colour, so that one corner does not take the whole scale."""

FINGER_COLOR, FINGER_OUTLINE, FINGER_OPACITY = np.array([0.45, 0.55, 0.68]), np.array([0.15, 0.2, 0.3]), 0.42
IDLE_COLOR, IDLE_FINGER_OPACITY = np.array([0.82, 0.82, 0.82]), 0.25
PLATFORM_COLOR, PLATFORM_THICKNESS, PLATFORM_MARGIN = np.array([0.9, 0.91, 0.93]), 0.003, 0.012
FILLET_POINTS = 6
"""Points across a rounded edge."""
AXIS_COLORS = ("#d62728", "#2ca02c", "#1f77b4")
AXIS_LENGTH, FORCE_LENGTH = 0.25, 0.35
"""Of the axes and of the largest force, in half heights of the picture."""
FORCE_COLOR, HELD_COLOR, FAILED_COLOR, TEXT_COLOR = "#00838f", "#1b7f3b", "#b3261e", "#3c4043"

BOX_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
BOX_TRIANGLES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)


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
    scene = _Scene(object_model, gripper, grasp, evaluation)
    stress = _stress_scale([scene])
    axes = figure.add_axes((0.01, 0.02, 0.66, 0.86))
    _draw_scene(axes, scene, stress, scene.camera((LARGE_PANEL_PIXELS, LARGE_PANEL_PIXELS)), detailed=True)
    title = f"{object_model.name}, grasp {grasp.id}"
    figure.text(0.03, 0.945, title, fontsize=17, weight="bold", va="center", parse_math=False)
    subtitle = f"{_object_text(object_model)};  {scene.stage_name}"
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
    scenes = [_Scene(object_model, gripper, grasp, evaluation) for grasp, evaluation in pairs[:MAX_PANELS]]
    stress = _stress_scale(scenes)
    columns = min(len(scenes), max(3, math.ceil(math.sqrt(1.6 * len(scenes)))))
    rows = math.ceil(len(scenes) / columns)
    width = max(PANEL_SIZE * columns, MIN_SHEET_WIDTH)
    height = HEAD + (PANEL_SIZE + CAPTION) * rows + FOOT
    margin = (width - PANEL_SIZE * columns) / 2.0
    figure = matplotlib.figure.Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    for index, scene in enumerate(scenes):
        row, column = divmod(index, columns)
        left, bottom = margin + PANEL_SIZE * column, height - HEAD - PANEL_SIZE * (row + 1) - CAPTION * row
        axes = figure.add_axes((left / width, bottom / height, PANEL_SIZE / width, PANEL_SIZE / height))
        camera = scene.camera((PANEL_PIXELS, PANEL_PIXELS))
        _draw_scene(axes, scene, stress, camera, detailed=False)
        _write_caption(axes, scene)
    held = sum(evaluation.metrics.pickup_success for _, evaluation in pairs)
    title = f"{object_model.name}: {held} of {len(pairs)} grasps picked up"
    if len(pairs) > MAX_PANELS:
        title += f" (the first {MAX_PANELS} are shown)"
    figure.text(0.2 / width, 1.0 - 0.32 / height, title, fontsize=15, weight="bold", va="center", parse_math=False)
    figure.text(
        0.2 / width, 1.0 - 0.62 / height, _object_text(object_model), fontsize=9.5, color=TEXT_COLOR, va="center"
    )
    if stress is not None:
        length = min(5.0, 0.6 * width)
        _add_colorbar(figure, ((width - length) / 2.0 / width, 0.42 / height, length / width, 0.12 / height), stress)
    figure.savefig(path, format="png")


@dataclass(frozen=True)
class _Scene:
    """What there is to draw of one evaluation."""

    object_model: ObjectModel
    gripper: Gripper
    grasp: Grasp
    evaluation: GraspEvaluation

    @property
    def stage(self) -> str | None:
        """The stage that is drawn; None if the object is drawn undeformed."""
        return next((stage for stage in STAGES if stage in self.evaluation.fields), None)

    @property
    def stage_name(self) -> str:
        """What is drawn, in words."""
        return STAGES[self.stage] if self.stage else "before the grasp"

    @property
    def positions(self) -> np.ndarray:
        """Nodes [m], shape ``(node, 3)``."""
        return self.evaluation.fields[self.stage].positions if self.stage else self.object_model.mesh.vertices

    @property
    def nodal_stress(self) -> np.ndarray | None:
        """Von Mises stress [Pa], mean of the adjacent elements weighted by volume, shape ``(node,)``."""
        if self.stage is None:
            return None
        return self.object_model.mesh.nodal_mean(self.evaluation.fields[self.stage].von_mises_stress)

    @property
    def fingers(self) -> list[np.ndarray]:
        """Vertices of the two fingers in the object frame [m], each of shape ``(vertex, 3)``."""
        opening = self.evaluation.fields[self.stage].opening if self.stage else self.gripper.max_opening
        shape, _ = _finger_surface(self.gripper)
        placed = [(shape + [0.0, opening, 0.0]) * [1.0, side, 1.0] for side in (1.0, -1.0)]
        return [self.grasp.position + vertices @ self.grasp.rotation.T for vertices in placed]

    @property
    def platform(self) -> np.ndarray | None:
        """Corners of the platform [m], shape ``(8, 3)``; None once it has gone."""
        if self.stage not in (None, PLATFORM_STAGE):
            return None
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        low[:2] -= PLATFORM_MARGIN
        high[:2] += PLATFORM_MARGIN
        low[2], high[2] = low[2] - PLATFORM_THICKNESS, low[2]
        return low + BOX_CORNERS * (high - low)

    def camera(self, shape: tuple[int, int]) -> Camera:
        """Return a view of everything, with so many rows and columns of pixels."""
        everything = [self.positions, *self.fingers, *([] if self.platform is None else [self.platform])]
        return Camera.around(np.concatenate(everything), AZIMUTH, ELEVATION, shape)

    def layers(self, camera: Camera, stress: ScalarMappable | None) -> list[Layer]:
        """Return object, fingers and platform as the camera sees them."""
        held = self.stage is not None
        surface = self.object_model.mesh.surface_triangles
        colors = stress.to_rgba(self.nodal_stress)[:, :3] if held else IDLE_COLOR
        layers = [solid(camera, self.positions, surface, colors)]
        _, left = _finger_surface(self.gripper)
        for vertices, triangles in zip(self.fingers, (left, left[:, ::-1]), strict=True):
            opacity = FINGER_OPACITY if held else IDLE_FINGER_OPACITY
            finger = solid(camera, vertices, triangles, FINGER_COLOR if held else IDLE_COLOR, opacity)
            layers.append(with_outline(finger, FINGER_OUTLINE, SUPERSAMPLING))
        if self.platform is not None:
            layers.append(solid(camera, self.platform, BOX_TRIANGLES, PLATFORM_COLOR))
        return layers


def _finger_surface(gripper: Gripper) -> tuple[np.ndarray, np.ndarray]:
    """Return the left finger with its pad face in the plane y = 0 and rounded edges.

    Returns:
        Vertices in the grasp frame [m], shape ``(vertex, 3)``, and triangles, counter-clockwise from outside.
    """
    arc = np.sin(np.linspace(0.0, np.pi / 2.0, FILLET_POINTS))
    side = gripper.pad_half_width + gripper.side_fillet * arc
    tip = gripper.pad_top + gripper.tip_fillet * arc
    across = _distinct(-side, side)
    along = _distinct([gripper.pad_bottom, gripper.tip], tip)
    x, z = np.meshgrid(across, along, indexing="ij")
    layers = [gripper.pad_drop(x, z), np.full_like(x, gripper.finger_thickness)]
    vertices = np.concatenate([np.column_stack([x.ravel(), y.ravel(), z.ravel()]) for y in layers])
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    face = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    following, back = np.roll(rim, -1), x.size
    wall = [[rim, rim + back, following + back], [rim, following + back, following]]
    return vertices, np.concatenate([face, face[:, ::-1] + back, *(np.column_stack(half) for half in wall)])


def _distinct(*coordinates: Sequence[float]) -> np.ndarray:
    """Return coordinates in ascending order, those once that differ by rounding only [m]."""
    return np.unique(np.round(np.concatenate(coordinates), 12))


def _stress_scale(scenes: Sequence[_Scene]) -> ScalarMappable | None:
    """Return the colours of stress [Pa] that suit all scenes; None if no scene has stress."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, PowerNorm

    peaks = [np.percentile(scene.nodal_stress, STRESS_PERCENTILE) for scene in scenes if scene.stage]
    if not peaks:
        return None
    colors = ListedColormap(colormaps[STRESS_COLORS](np.linspace(*STRESS_COLOR_RANGE, 256)))
    return ScalarMappable(PowerNorm(STRESS_EXPONENT, 0.0, max(*peaks, 1e-9), clip=True), colors)


def _draw_scene(axes: Axes, scene: _Scene, stress: ScalarMappable | None, camera: Camera, detailed: bool) -> None:
    """Draw into axes whose coordinates become those of the camera [m]."""
    fine = Camera(
        camera.centre, camera.rotation, camera.half_height, tuple(SUPERSAMPLING * side for side in camera.shape)
    )
    softness = 0.012 * fine.shape[0]
    image = downsample(compose(scene.layers(fine, stress), np.ones(3), softness), SUPERSAMPLING)
    axes.imshow(image, extent=camera.extent, interpolation="antialiased")
    axes.set_axis_off()
    _draw_forces(axes, scene, camera, detailed)
    _draw_axes(axes, scene, camera, detailed)
    _draw_scale_bar(axes, camera)


def _draw_forces(axes: Axes, scene: _Scene, camera: Camera, detailed: bool) -> None:
    """Draw the force of each contact point on the object as an arrow that ends at the point, pale if behind it."""
    if scene.stage is None or not scene.evaluation.contacts:
        return
    positions = np.concatenate([contact.positions for contact in scene.evaluation.contacts])
    forces = np.concatenate([contact.forces for contact in scene.evaluation.contacts])
    if len(forces) == 0:
        return
    normals = np.concatenate([contact.normals for contact in scene.evaluation.contacts])
    is_behind = normals @ camera.rotation[2] > 0.0
    arrows = forces / np.linalg.norm(forces, axis=1).max() * (FORCE_LENGTH * camera.half_height)
    heads, tails = camera.view(positions)[:, :2], camera.view(positions - arrows)[:, :2]
    for head, tail, behind in zip(heads, tails, is_behind, strict=True):
        _draw_arrow(axes, tail, head, FORCE_COLOR, 1.8 if detailed else 1.0, opacity=0.4 if behind else 1.0)


def _draw_axes(axes: Axes, scene: _Scene, camera: Camera, detailed: bool) -> None:
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
    length = max(step for step in _round_numbers(1e-4, 0.2 * width))
    start, level = left + 0.04 * width, bottom + 0.01 * width
    axes.plot([start, start + length], [level, level], color=TEXT_COLOR, linewidth=1.6, solid_capstyle="butt")
    label = f"{length * 1e3:g} mm"
    axes.text(start + length / 2.0, level + 0.012 * width, label, fontsize=7, color=TEXT_COLOR, ha="center")


def _round_numbers(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2 and 5 times a power of ten in the interval."""
    powers = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 1)
    return [step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0) if low <= step * 10.0**power <= high]


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


def _write_caption(axes: Axes, scene: _Scene) -> None:
    """Write grasp, outcome and metrics below a panel."""
    outcome, color = _outcome(scene.evaluation)
    at = {"transform": axes.transAxes, "ha": "center", "va": "top"}
    axes.text(0.5, 0.0, f"{scene.grasp.id}: {outcome}", color=color, fontsize=10, weight="bold", parse_math=False, **at)
    metrics = scene.evaluation.metrics
    numbers = [_number(getattr(metrics, name), factor, unit, style) for name, _, factor, unit, style in METRIC_COLUMNS]
    known = any(number != "-" for number in numbers)
    axes.text(0.5, -0.08, "   ".join(numbers) if known else scene.stage_name, color=TEXT_COLOR, fontsize=8, **at)


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
    bar.set_label("von Mises stress", fontsize=9)
    bar.set_ticks([0.0, *_round_numbers(stress.norm.vmax / 12.0, stress.norm.vmax)])
    bar.ax.minorticks_off()
    bar.ax.xaxis.set_major_formatter(EngFormatter("Pa"))
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_linewidth(0.5)
