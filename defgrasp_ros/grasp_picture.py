"""Pictures of sampled grasps: the object and, for each grasp, a fork where the gripper is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.rendering import Camera, compose, downsample, solid
from defgrasp_ros.scene import BOX_CORNERS, BOX_TRIANGLES

OBJECT_COLOR = np.array([0.86, 0.84, 0.8])
FORK_COLORS = "turbo"
BAR = 0.012
"""Width of a fork's bars, relative to the largest extent of what is shown."""
STEM = 0.035
"""Length of the fork's stem [m]."""
VIEWS = ((-50.0, 22.0), (40.0, 22.0), (-90.0, 89.0))
"""Azimuth and elevation of the views [deg]."""
PIXELS, SUPERSAMPLING, DPI = 620, 2, 150


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

    forks = [_fork(grasp, gripper, BAR * float(np.ptp(vertices, axis=0).max())) for grasp in grasps]
    corners = np.concatenate(forks)
    boxes = len(corners) // len(BOX_CORNERS)
    fork_triangles = (BOX_TRIANGLES + len(BOX_CORNERS) * np.arange(boxes)[:, None, None]).reshape(-1, 3)
    shades = colormaps[FORK_COLORS](np.linspace(0.08, 0.92, len(grasps)))[:, :3]
    fork_colors = np.repeat(shades, [len(fork) for fork in forks], axis=0)
    everything = np.concatenate([vertices, corners])
    figure = matplotlib.figure.Figure(figsize=(4.2 * len(VIEWS), 4.7), dpi=DPI, facecolor="white")
    for column, (azimuth, elevation) in enumerate(VIEWS):
        shape = (SUPERSAMPLING * PIXELS, SUPERSAMPLING * PIXELS)
        camera = Camera.around(everything, math.radians(azimuth), math.radians(elevation), shape)
        layers = [
            solid(camera, vertices, triangles, OBJECT_COLOR),
            solid(camera, corners, fork_triangles, fork_colors),
        ]
        axes = figure.add_axes((column / len(VIEWS), 0.0, 1.0 / len(VIEWS), 0.89))
        axes.imshow(downsample(compose(layers, np.ones(3), 0.012 * shape[0]), SUPERSAMPLING), extent=camera.extent)
        axes.set_axis_off()
    title = f"{name}: {len(grasps)} grasps, {gripper.name}"
    figure.text(0.012, 0.94, title, fontsize=14, weight="bold", va="center", parse_math=False)
    figure.savefig(path, format="png")


def _fork(grasp: Grasp, gripper: Gripper, bar: float) -> np.ndarray:
    """Return the corners of four bars: two fingers, what joins them, and the stem; object frame [m]."""
    half, reach = bar / 2.0, gripper.max_opening
    bars = [
        ((-half, reach, gripper.pad_bottom), (half, reach + bar, gripper.tip)),
        ((-half, -reach - bar, gripper.pad_bottom), (half, -reach, gripper.tip)),
        ((-half, -reach - bar, gripper.pad_bottom - bar), (half, reach + bar, gripper.pad_bottom)),
        ((-half, -half, gripper.pad_bottom - bar - STEM), (half, half, gripper.pad_bottom - bar)),
    ]
    corners = [np.array(low) + BOX_CORNERS * (np.array(high) - low) for low, high in bars]
    return grasp.position + np.concatenate(corners) @ grasp.rotation.T
