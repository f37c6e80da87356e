"""Whether a surface overlaps itself, and how much it encloses then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defgrasp_ros.mesh.rays import RayCaster
from defgrasp_ros.mesh.surface_geometry import triangle_normals

RAYS_PER_SIDE = 40
"""Rays along each side of the bounding box."""


@dataclass(frozen=True)
class EnclosedVolume:
    """What a closed surface encloses, measured along a bundle of parallel rays; about 1 % accurate.

    Args:
        union: Volume that is inside at least once [m^3].
        overlap: Volume that is inside more than once, or inside out [m^3].
    """

    union: float
    overlap: float


def enclosed_volume(vertices: np.ndarray, triangles: np.ndarray) -> EnclosedVolume:
    """Measure what a closed, oriented surface encloses.

    Along a ray the winding number grows by one where it enters and falls by one where it leaves.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    along = int(np.argmax(high - low))
    across = [axis for axis in range(3) if axis != along]
    # One ray at a random place of each cell: a regular lattice would run along a designed shape's edges.
    cells = np.stack(np.meshgrid(*2 * [np.arange(RAYS_PER_SIDE)], indexing="ij"), axis=-1).reshape(-1, 2)
    grid = (cells + np.random.default_rng(0).random(cells.shape)) / RAYS_PER_SIDE
    origins = np.empty((len(grid), 3))
    origins[:, across] = low[across] + grid * (high - low)[across]
    origins[:, along] = low[along] - 0.1 * (high - low)[along]
    direction = np.eye(3)[along]
    hits = RayCaster(vertices, triangles).cast(origins, np.broadcast_to(direction, origins.shape))
    change = -np.sign(triangle_normals(vertices, triangles)[hits.triangle] @ direction)
    winding = np.cumsum(change)
    first = np.flatnonzero(np.diff(hits.ray, prepend=-1))
    before = np.repeat(winding[first] - change[first], np.diff(first, append=len(hits.ray)))
    winding -= before
    same_ray = np.diff(hits.ray, append=-1) == 0
    lengths = np.where(same_ray, np.diff(hits.distance, append=0.0), 0.0)
    cell = float(np.prod((high - low)[across])) / RAYS_PER_SIDE**2
    union = lengths[winding > 0.5].sum() * cell
    overlap = lengths[(winding > 1.5) | (winding < -0.5)].sum() * cell
    return EnclosedVolume(float(union), float(overlap))
