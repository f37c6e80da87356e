"""Pictures of sampled grasps: the object and, for each grasp, a fork where the gripper is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defgrasp_ros.drawing.color_scales import TEXT_COLOR
from defgrasp_ros.drawing.rendering import Camera, compose, downsample, solid
from defgrasp_ros.drawing.scene import BOX_CORNERS, BOX_TRIANGLES, SOFTNESS, SUPERSAMPLING
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OBJECT_COLOR = np.array([0.86, 0.84, 0.8])
FORK_COLORS, FORK_COLOR_RANGE = "turbo", (0.08, 0.92)
BAR = 0.012
"""Width of a fork's bars, relative to the largest extent of what is shown."""
STEM = 0.035
"""Length of the fork's stem [m]."""
FINGERS, HAND_OPACITY = 2, 0.3
"""The first bars of a fork are its fingers; the others, the hand, are translucent, so that they hide less."""
VIEWS = (("from the front", -50.0, 22.0), ("from the right", 40.0, 22.0), ("from above", -90.0, 89.0))
"""Name, azimuth and elevation of the views [deg]."""
PIXELS, DPI = 620, 150


def draw_grasps(
    path: Path | str,
    name: str,
    vertices: np.ndarray,
    triangles: np.ndarray,
    gripper: Gripper,
    grasps: Sequence[Grasp],
) -> None:
    """Draw grasps from three sides and write a PNG; colours run from the first grasp (blue) to the last (red).

    Args:
        path: The picture to write.
        name: Of the object, for the title.
        vertices: Its surface [m], shape ``(vertex, 3)``.
        triangles: Counter-clockwise from outside, shape ``(triangle, 3)``.
        gripper: Gives the size of the forks.
        grasps: The poses.
    """
    import matplotlib.figure
    from matplotlib import colormaps

    bar = BAR * float(np.ptp(vertices, axis=0).max())
    forks = np.array([_fork(grasp, gripper, bar) for grasp in grasps])
    shades = colormaps[FORK_COLORS](np.linspace(*FORK_COLOR_RANGE, len(grasps)))[:, :3]
    everything = np.concatenate([vertices, forks.reshape(-1, 3)])
    figure = matplotlib.figure.Figure(figsize=(4.2 * len(VIEWS), 4.7), dpi=DPI, facecolor="white")
    for column, (name_of_view, azimuth, elevation) in enumerate(VIEWS):
        shape = (SUPERSAMPLING * PIXELS, SUPERSAMPLING * PIXELS)
        camera = Camera.around(everything, math.radians(azimuth), math.radians(elevation), shape)
        layers = [
            solid(camera, vertices, triangles, OBJECT_COLOR),
            solid(camera, *_bars(forks[:, :FINGERS], shades)),
            solid(camera, *_bars(forks[:, FINGERS:], shades), opacity=HAND_OPACITY),
        ]
        axes = figure.add_axes((column / len(VIEWS), 0.04, 1.0 / len(VIEWS), 0.87))
        axes.imshow(downsample(compose(layers, np.ones(3), SOFTNESS * shape[0]), SUPERSAMPLING), extent=camera.extent)
        axes.set_axis_off()
        axes.text(0.5, -0.03, name_of_view, transform=axes.transAxes, fontsize=9, color=TEXT_COLOR, ha="center")
    _write_scale(figure, len(grasps))
    title = f"{name}: {len(grasps)} grasps, {gripper.name}"
    figure.text(0.012, 0.94, title, fontsize=14, weight="bold", va="center", parse_math=False)
    figure.savefig(path, format="png")


def _write_scale(figure: Figure, count: int) -> None:
    """Say which colour which grasp has, in the upper right corner."""
    from matplotlib import colormaps

    axes = figure.add_axes((0.82, 0.93, 0.12, 0.022))
    axes.imshow(colormaps[FORK_COLORS](np.linspace(*FORK_COLOR_RANGE, 256))[None, :, :3], aspect="auto")
    axes.set_axis_off()
    figure.text(0.812, 0.941, "grasp 0", fontsize=9, color=TEXT_COLOR, ha="right", va="center")
    figure.text(0.948, 0.941, str(count - 1), fontsize=9, color=TEXT_COLOR, va="center")


def _bars(corners: np.ndarray, shades: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, triangles and colours of bars, given their corners, shape ``(grasp, bar, 8, 3)``."""
    grasps, bars = corners.shape[:2]
    triangles = (BOX_TRIANGLES + len(BOX_CORNERS) * np.arange(grasps * bars)[:, None, None]).reshape(-1, 3)
    return corners.reshape(-1, 3), triangles, np.repeat(shades, bars * len(BOX_CORNERS), axis=0)


def _fork(grasp: Grasp, gripper: Gripper, bar: float) -> np.ndarray:
    """Return the corners of four bars: two fingers, what joins them, and the stem; object frame [m].

    Shape ``(4, 8, 3)``.
    """
    half, reach = bar / 2.0, gripper.max_opening
    bars = [
        ((-half, reach, gripper.pad_bottom), (half, reach + bar, gripper.tip)),
        ((-half, -reach - bar, gripper.pad_bottom), (half, -reach, gripper.tip)),
        ((-half, -reach - bar, gripper.pad_bottom - bar), (half, reach + bar, gripper.pad_bottom)),
        ((-half, -half, gripper.pad_bottom - bar - STEM), (half, half, gripper.pad_bottom - bar)),
    ]
    corners = [np.array(low) + BOX_CORNERS * (np.array(high) - low) for low, high in bars]
    return grasp.position + np.array(corners) @ grasp.rotation.T
