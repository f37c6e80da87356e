"""One picture of all objects of the library."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from defgrasp_ros.drawing.color_scales import TEXT_COLOR
from defgrasp_ros.drawing.rendering import Camera, compose, downsample, solid
from defgrasp_ros.objects.library import LibraryObject

COLORS = {
    "primitive": np.array([0.55, 0.66, 0.78]),
    "hollow": np.array([0.62, 0.74, 0.62]),
    "food": np.array([0.86, 0.68, 0.44]),
    "organ": np.array([0.8, 0.52, 0.5]),
}
COLUMNS, PANEL, CAPTION, HEAD = 8, 1.5, 0.42, 0.55
"""Layout [inch]."""
LEGEND_LEFT, LEGEND_STEP = 1.5, 1.1
"""Of the colours' names beside the title [inch]."""
PIXELS, SUPERSAMPLING, DPI = 225, 3, 150
AZIMUTH, ELEVATION = math.radians(-55.0), math.radians(28.0)


def draw_objects(path: Path | str, objects: Sequence[LibraryObject]) -> None:
    """Draw objects side by side, each as large as its panel, with its size, and write a PNG."""
    import matplotlib.figure

    rows = math.ceil(len(objects) / COLUMNS)
    width, height = COLUMNS * PANEL, HEAD + rows * (PANEL + CAPTION)
    figure = matplotlib.figure.Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    for index, entry in enumerate(objects):
        row, column = divmod(index, COLUMNS)
        vertices, triangles = entry.surface()
        shape = (SUPERSAMPLING * PIXELS, SUPERSAMPLING * PIXELS)
        camera = Camera.around(vertices, AZIMUTH, ELEVATION, shape, margin=1.15)
        layers = [solid(camera, vertices, triangles, COLORS[entry.category])]
        image = downsample(compose(layers, np.ones(3), 0.02 * shape[0]), SUPERSAMPLING)
        bottom = height - HEAD - row * (PANEL + CAPTION) - PANEL
        axes = figure.add_axes((column * PANEL / width, bottom / height, PANEL / width, PANEL / height))
        axes.imshow(image)
        axes.set_axis_off()
        sides = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(vertices, axis=0))
        at = {"transform": axes.transAxes, "ha": "center", "va": "top", "parse_math": False}
        axes.text(0.5, 0.03, entry.name, fontsize=8, weight="bold", **at)
        axes.text(0.5, -0.07, f"{sides} mm\n{entry.material.name}", fontsize=5.5, color=TEXT_COLOR, **at)
    level = 1.0 - 0.26 / height
    figure.text(0.1 / width, level, f"{len(objects)} objects", fontsize=12, weight="bold", va="center")
    for place, (category, color) in enumerate(COLORS.items()):
        left = LEGEND_LEFT + LEGEND_STEP * place
        figure.text(left / width, level, "●", fontsize=13, color=color, va="center")
        figure.text((left + 0.2) / width, level, category, fontsize=9, color=TEXT_COLOR, va="center")
    figure.savefig(path, format="png")
