"""Random points on a surface and random directions."""

from __future__ import annotations

import numpy as np


def surface_points(
    vertices: np.ndarray, triangles: np.ndarray, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return points uniform over the area.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``.
        count: How many points.
        random: Source of chance.

    Returns:
        Points [m], shape ``(count, 3)``, and their triangles, shape ``(count,)``.
    """
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = random.choice(len(triangles), size=count, p=areas / areas.sum())
    u, v = random.random((2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen], chosen


def in_cone(axes: np.ndarray, max_angle: float, random: np.random.Generator) -> np.ndarray:
    """Return unit vectors uniform over the solid angle within ``max_angle`` [rad] of the given unit vectors."""
    cosine = random.uniform(np.cos(max_angle), 1.0, len(axes))[:, None]
    sideways = perpendicular(axes, random.uniform(-np.pi, np.pi, len(axes)))
    return cosine * axes + np.sqrt(1.0 - cosine**2) * sideways


def perpendicular(axes: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the unit vectors across unit vectors ``(n, 3)`` at the given angles about them [rad], ``(n,)``."""
    smallest = np.eye(3)[np.abs(axes).argmin(axis=1)]
    first = np.cross(axes, smallest)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axes, first)
    return np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
