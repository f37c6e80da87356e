"""Objects with thin walls, as tetrahedra in layers through the wall (see ``mesh/shell.py``). Lengths in [m]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from defgrasp_ros.mesh.shell import LAYERS, NODES_PER_VERTEX, layered_wall
from defgrasp_ros.mesh.tet_mesh import DEFAULT_ELEMENT_ORDER, TetMesh
from defgrasp_ros.objects.revolution import resampled, revolved

NODES = 1_150
"""Nodes aimed at."""


def tube(radius: float, height: float, wall: float, element_order: int = DEFAULT_ELEMENT_ORDER) -> TetMesh:
    """Return an upright tube; ``radius`` is the outer one."""
    return _hollow([[radius, 0.0], [radius, height]], wall, element_order)


def cup(
    radius: float, base_radius: float, height: float, wall: float, element_order: int = DEFAULT_ELEMENT_ORDER
) -> TetMesh:
    """Return a cup, open at the top, wider there than at its base."""
    fillet = 0.15 * base_radius
    corner = _arc((base_radius - fillet, fillet), fillet, -np.pi / 2.0, 0.0)
    return _hollow([[0.0, 0.0], *corner, [radius, height]], wall, element_order)


def bowl(radius: float, height: float, wall: float, element_order: int = DEFAULT_ELEMENT_ORDER) -> TetMesh:
    """Return a bowl: part of an ellipsoid on a flat foot, open at the top."""
    angles = np.linspace(0.0, np.pi / 2.0, 40)
    profile = np.column_stack([radius * np.sin(angles), height * (1.0 - np.cos(angles))])
    foot = 0.06 * height
    kept = profile[profile[:, 1] > foot]
    return _hollow([[0.0, foot], [np.interp(foot, *profile.T[::-1]), foot], *kept], wall, element_order)


def bottle(
    radius: float,
    neck_radius: float,
    height: float,
    wall: float,
    flatness: float = 1.0,
    element_order: int = DEFAULT_ELEMENT_ORDER,
) -> TetMesh:
    """Return a bottle, open at the top; ``flatness`` is its depth along y relative to its width."""
    fillet, shoulder = 0.25 * radius, 0.62 * height
    rise = min(0.8 * (radius - neck_radius), 0.2 * height)
    turn = np.linspace(0.0, np.pi, 24)
    blend = neck_radius + (radius - neck_radius) * (1.0 + np.cos(turn)) / 2.0
    profile = [[0.0, 0.0], *_arc((radius - fillet, fillet), fillet, -np.pi / 2.0, 0.0)]
    profile += [[r, z] for r, z in zip(blend, shoulder + 1.3 * rise * turn / np.pi, strict=True)]
    return _hollow([*profile, [neck_radius, height]], wall, element_order, flatness)


def _hollow(profile: Sequence[Sequence[float]], wall: float, element_order: int, flatness: float = 1.0) -> TetMesh:
    """Turn the outer profile, from the axis or the lower rim to the upper rim, and give the surface a wall."""
    corners = np.array(profile, dtype=float)
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    area = 2.0 * np.pi * float(((corners[1:, 0] + corners[:-1, 0]) / 2.0 * lengths).sum())
    # Each vertex of an even triangulation has an area of sqrt(3)/2 spacing^2.
    spacing = (area / (NODES / NODES_PER_VERTEX[element_order]) / (3.0**0.5 / 2.0)) ** 0.5
    vertices, triangles = revolved(_evenly(corners, 3.0**0.5 / 2.0 * spacing), spacing)
    vertices[:, 1] *= flatness
    return layered_wall(vertices, triangles, wall, LAYERS[element_order])


def _evenly(corners: np.ndarray, spacing: float) -> np.ndarray:
    """Return points evenly spaced along a polyline, with both ends; small steps are passed over, corners cut."""
    fine = resampled(corners, spacing / 20.0)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    steps = max(2, round(along[-1] / spacing))
    places = np.linspace(0.0, along[-1], steps + 1)
    return np.column_stack([np.interp(places, along, fine[:, 0]), np.interp(places, along, fine[:, 1])])


def _arc(centre: tuple[float, float], radius: float, start: float, end: float) -> list[list[float]]:
    angles = np.linspace(start, end, 9)
    return [[centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a)] for a in angles]
