"""Surfaces of revolution with triangles of even size."""

from __future__ import annotations

import numpy as np

MIN_RING = 6
"""Vertices of the smallest ring."""


def resampled(profile: np.ndarray, spacing: float) -> np.ndarray:
    """Return a polyline with about evenly spaced points that keeps its corners.

    Args:
        profile: Corners, shape ``(corner, 2)``.
        spacing: Largest distance of two points.
    """
    points = [profile[:1]]
    for start, end in zip(profile[:-1], profile[1:], strict=True):
        steps = max(1, int(np.ceil(np.linalg.norm(end - start) / spacing - 1e-9)))
        points.append(start + (end - start) * np.arange(1, steps + 1)[:, None] / steps)
    return np.concatenate(points)


def revolved(profile: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface that a profile sweeps when it is turned about the z axis.

    Each point becomes a ring of as many vertices as its circumference needs, or one vertex on the axis; rings are
    joined like the two sides of a zip. The surface is open where the profile ends off the axis.

    Args:
        profile: Distance from the axis and height [m], shape ``(point, 2)``; the outside is to the right of
            its direction, so that it runs up along the outer side.
        spacing: Distance of the vertices around the axis [m].

    Returns:
        Vertices [m], shape ``(vertex, 3)``, and triangles, counter-clockwise from outside, shape ``(triangle, 3)``.
    """
    rings, vertices, total = [], [], 0
    for number, (radius, height) in enumerate(profile):
        on_axis = radius < 1e-9
        count = 1 if on_axis else max(MIN_RING, round(2.0 * np.pi * radius / spacing))
        # Every second ring is turned by half a step, so that triangles are nearly equilateral.
        angles = 2.0 * np.pi * (np.arange(count) + 0.5 * (number % 2)) / count
        vertices.append(np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)]))
        rings.append((total + np.arange(count), angles))
        total += count
    triangles = [_zipped(*lower, *upper) for lower, upper in zip(rings[:-1], rings[1:], strict=True)]
    return np.concatenate(vertices), np.concatenate(triangles)


def _zipped(lower: np.ndarray, lower_angles: np.ndarray, upper: np.ndarray, upper_angles: np.ndarray) -> np.ndarray:
    """Return the triangles between two rings, or a ring and a point."""
    if len(lower) == 1 and len(upper) == 1:
        return np.empty((0, 3), dtype=np.int64)
    triangles, i, j = [], 0, 0
    while i < len(lower) or j < len(upper):
        next_lower = lower_angles[0] + 2.0 * np.pi * (i + 1) / len(lower)
        next_upper = upper_angles[0] + 2.0 * np.pi * (j + 1) / len(upper)
        a, b = lower[i % len(lower)], upper[j % len(upper)]
        if len(upper) == 1 or (len(lower) > 1 and i < len(lower) and (next_lower <= next_upper or j == len(upper))):
            triangles.append((a, lower[(i + 1) % len(lower)], b))
            i += 1
            j = max(j, 1) if len(upper) == 1 else j
        else:
            triangles.append((a, upper[(j + 1) % len(upper)], b))
            j += 1
            i = max(i, 1) if len(lower) == 1 else i
    return np.array(triangles, dtype=np.int64)
