"""Brings the triangles of a surface to the size that is wanted."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

TRIANGLES_PER_FACE = 3
"""Triangles kept for each boundary face of the mesh to come."""

MIN_TRIANGLES = 100
"""As many triangles are kept however large the elements are to be."""

LONGEST_TRIANGLE_EDGE = 4.0 / 3.0
"""In edge lengths of the elements; the length at which fTetWild splits edges too."""

AGGRESSIONS = (2, 1)
"""How fast the allowed error grows during a decimation; with the library's default of 7 triangles become slivers."""

MAX_DENT = 0.02
"""Largest relative change of volume in a decimation."""

REGULAR_TRIANGLE = 3.0**0.5 / 4.0
"""Area of the regular triangle of edge length 1."""


def with_triangle_size(surface: trimesh.Trimesh, edge_length: float, per_face: float = 1.0) -> trimesh.Trimesh:
    """Return the surface with larger or smaller triangles.

    Args:
        surface: The surface; smaller triangles keep its shape, larger ones only nearly.
        edge_length: Edge length of the triangles [m].
        per_face: As many triangles are allowed for each one of that edge length.
    """
    import trimesh

    faces = surface.area / (REGULAR_TRIANGLE * edge_length**2)
    count = max(MIN_TRIANGLES, int(per_face * faces))
    if len(surface.faces) > count:
        return _decimated(surface, count)
    split = split_long_edges(surface.vertices, surface.faces, LONGEST_TRIANGLE_EDGE * edge_length, count)
    return trimesh.Trimesh(*split, process=False)


def _decimated(surface: trimesh.Trimesh, count: int) -> trimesh.Trimesh:
    """Return the surface with so many triangles; as it is where decimation would tear it open or dent it."""
    volume, closed = float(surface.volume), surface.is_watertight
    for aggression in AGGRESSIONS:
        coarse = surface.simplify_quadric_decimation(face_count=count, aggression=aggression)
        if not closed or (coarse.is_watertight and abs(coarse.volume - volume) < MAX_DENT * abs(volume)):
            return coarse
    return surface


def split_long_edges(
    vertices: np.ndarray,
    triangles: np.ndarray,
    max_length: float | Callable[[np.ndarray], np.ndarray],
    max_triangles: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Halve edges until none is too long or there are enough triangles; the surface keeps its shape.

    The length can depend on the place: a function of the edges' middles [m], shape ``(edge, 3)``. An edge is split
    where it is the longest one of both of its triangles, so that they stay joined and well shaped.
    """
    while len(triangles) < max_triangles:
        pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        edges, edge_of_side = np.unique(pairs, axis=0, return_inverse=True)
        edge_of_side = edge_of_side.reshape(-1, 3)
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        rank = np.empty(len(edges), dtype=int)
        rank[np.argsort(lengths, kind="stable")] = np.arange(len(edges))  # no two edges are equally long
        longest_side = rank[edge_of_side].argmax(axis=1)
        longest = np.take_along_axis(edge_of_side, longest_side[:, None], axis=1)[:, 0]
        is_longest_of_all = np.bincount(longest, minlength=len(edges)) == np.bincount(edge_of_side.ravel())
        limit = max_length(vertices[edges].mean(axis=1)) if callable(max_length) else max_length
        to_split = is_longest_of_all & (lengths > limit)
        if not to_split.any():
            break
        middle = np.cumsum(to_split) - 1 + len(vertices)
        vertices = np.concatenate([vertices, vertices[edges[to_split]].mean(axis=1)])
        halved = to_split[longest]
        sides = (longest_side[halved, None] + np.arange(3)) % 3
        start, end, apex = np.take_along_axis(triangles[halved], sides, axis=1).T
        new = middle[longest[halved]]
        halves = [np.column_stack([start, new, apex]), np.column_stack([new, end, apex])]
        triangles = np.concatenate([triangles[~halved], *halves])
    return vertices, triangles
