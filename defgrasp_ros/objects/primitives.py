"""Solids of simple geometry, as closed surfaces with triangles of a few millimetres. Lengths in [m]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from defgrasp_ros.mesh.rounding import with_rounded_edges
from defgrasp_ros.objects.revolution import resampled, revolved

Surface = tuple[np.ndarray, np.ndarray]
"""Vertices [m], shape ``(vertex, 3)``, and triangles, counter-clockwise from outside, shape ``(triangle, 3)``."""

SUBDIVISIONS = 4
"""Of the icosahedron behind rounded shapes: 2562 vertices."""

RING = 64
"""Vertices around a round solid."""


def unit_sphere() -> Surface:
    """Return a sphere of radius 1 with evenly spread vertices."""
    sphere = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS)
    return np.asarray(sphere.vertices), np.asarray(sphere.faces)


def ellipsoid(semi_axes: Sequence[float], flat_base: float = 0.0, edge_radius: float | None = None) -> Surface:
    """Return an ellipsoid; ``flat_base`` is the share of its height that is cut off below, in [0, 0.5]."""
    if not flat_base:
        vertices, triangles = unit_sphere()
        return vertices * semi_axes, triangles
    angles = np.linspace(np.arcsin(2.0 * flat_base - 1.0), np.pi / 2.0, 40)
    arc = np.column_stack([np.cos(angles), np.sin(angles)])
    base = np.array([[0.0, arc[0, 1]], arc[0]])
    spacing = 2.0 * np.pi / RING
    vertices, triangles = revolved(np.concatenate([resampled(base, spacing), resampled(arc, spacing)[1:]]), spacing)
    return _rounded(trimesh.Trimesh(vertices * semi_axes, triangles, process=False), edge_radius)


def cylinder(
    radius: float, height: float, top_radius: float | None = None, edge_radius: float | None = None
) -> Surface:
    """Return an upright cylinder, or a frustum where the top has another radius."""
    top = radius if top_radius is None else top_radius
    return _turned([[0.0, 0.0], [radius, 0.0], [top, height], [0.0, height]], edge_radius)


def annulus(outer_radius: float, inner_radius: float, height: float, edge_radius: float | None = None) -> Surface:
    """Return an upright thick-walled tube."""
    corners = [[inner_radius, 0.0], [outer_radius, 0.0], [outer_radius, height], [inner_radius, height]]
    return _turned([*corners, corners[0]], edge_radius)


def ring(radius: float, thickness: float) -> Surface:
    """Return a torus lying flat; ``radius`` is that of its centre line, ``thickness`` the diameter of its section."""
    angles = np.linspace(0.0, 2.0 * np.pi, 25)
    profile = np.column_stack([radius + thickness / 2.0 * np.cos(angles), thickness / 2.0 * np.sin(angles)])
    profile[-1] = profile[0]
    return _merged(*revolved(profile, 2.0 * np.pi * radius / RING))


def cuboid(extents: Sequence[float], edge_radius: float | None = None) -> Surface:
    """Return a block."""
    return _rounded(trimesh.creation.box(extents), edge_radius)


def prism(sides: int, radius: float, height: float, edge_radius: float | None = None) -> Surface:
    """Return an upright prism over a regular polygon whose corners are at ``radius`` from the axis."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    bottom, top = (np.column_stack([corners, np.full(sides, z)]) for z in (0.0, height))
    vertices = np.concatenate([bottom, top, [[0.0, 0.0, 0.0], [0.0, 0.0, height]]])
    here, after = np.arange(sides), (np.arange(sides) + 1) % sides
    triangles = np.concatenate(
        [
            np.column_stack([here, after, after + sides]),
            np.column_stack([here, after + sides, here + sides]),
            np.column_stack([after, here, np.full(sides, 2 * sides)]),
            np.column_stack([here + sides, after + sides, np.full(sides, 2 * sides + 1)]),
        ]
    )
    return _rounded(trimesh.Trimesh(vertices, triangles, process=False), edge_radius)


def wedge(radius: float, angle: float, core_radius: float, edge_radius: float | None = None) -> Surface:
    """Return a wedge cut out of a ball, without its core, lying on one of its cut faces; ``angle`` [rad]."""
    turns = np.linspace(-angle / 2.0, angle / 2.0, 13)
    heights = np.linspace(-1.0, 1.0, 33) * np.sqrt(1.0 - (core_radius / radius) ** 2)
    outer = radius * np.sqrt(1.0 - heights**2)
    outline = np.concatenate(
        [np.column_stack([outer, radius * heights]), [[core_radius, radius * z] for z in heights[-2:0:-1]]]
    )
    around = np.stack(
        [outline[:, 0] * np.cos(turns)[:, None], outline[:, 0] * np.sin(turns)[:, None]]
        + [np.broadcast_to(outline[:, 1], (len(turns), len(outline)))],
        axis=-1,
    ).reshape(-1, 3)
    count, here = len(outline), np.arange(len(outline))
    after = (here + 1) % count
    triangles = []
    for layer in range(len(turns) - 1):
        low, high = layer * count, (layer + 1) * count
        triangles += [np.column_stack([low + here, high + here, high + after])]
        triangles += [np.column_stack([low + here, high + after, low + after])]
    open_wedge = trimesh.Trimesh(around, np.concatenate(triangles), process=False)
    solid = _capped(open_wedge)
    if solid.volume < 0.0:
        solid.invert()
    # One cut face is turned into the plane y = 0, and y then upwards.
    for turn, axis in ((angle / 2.0, [0.0, 0.0, 1.0]), (np.pi / 2.0, [1.0, 0.0, 0.0])):
        solid.apply_transform(trimesh.transformations.rotation_matrix(turn, axis))
    return _rounded(solid, edge_radius)


def _turned(corners: Sequence[Sequence[float]], edge_radius: float | None) -> Surface:
    corners = np.array(corners)
    spacing = 2.0 * np.pi * corners[:, 0].max() / RING
    surface = _merged(*revolved(resampled(corners, spacing), spacing))
    return _rounded(trimesh.Trimesh(*surface, process=False), edge_radius)


def _merged(vertices: np.ndarray, triangles: np.ndarray) -> Surface:
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    surface.merge_vertices()
    return np.asarray(surface.vertices), np.asarray(surface.faces)


def _capped(surface: trimesh.Trimesh) -> trimesh.Trimesh:
    """Close each hole with a fan about its middle."""
    surface.merge_vertices()
    vertices, triangles = np.asarray(surface.vertices), np.asarray(surface.faces)
    edges = surface.edges
    _, inverse, counts = np.unique(surface.edges_sorted, axis=0, return_inverse=True, return_counts=True)
    rim = edges[counts[inverse.ravel()] == 1]
    loops = trimesh.graph.connected_components(rim)
    for loop in loops:
        here = rim[np.isin(rim[:, 0], loop)]
        triangles = np.concatenate([triangles, np.column_stack([here[:, ::-1], np.full(len(here), len(vertices))])])
        vertices = np.concatenate([vertices, vertices[loop].mean(axis=0, keepdims=True)])
    return trimesh.Trimesh(vertices, triangles, process=False)


def _rounded(surface: trimesh.Trimesh, edge_radius: float | None) -> Surface:
    if edge_radius is not None:
        surface = with_rounded_edges(surface, edge_radius)
    return np.asarray(surface.vertices), np.asarray(surface.faces)
