"""Rounds the sharp edges of a surface: at a sharp edge the stress grows without bound as the mesh gets finer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError
from defgrasp_ros.mesh.triangle_size import REGULAR_TRIANGLE, split_long_edges

if TYPE_CHECKING:
    import trimesh

SHARP_ANGLE = np.radians(30.0)
"""Edges at which the surface turns by more than this are sharp [rad]."""

EDGES_PER_RADIUS = 1.0
"""Triangle edges within the radius."""

REACH = 1.5
"""How far from a sharp edge the surface is changed, in radii."""

GRADING = 0.5
"""How fast triangle edges may grow with the distance from there."""

MAX_TRIANGLES = 200_000
MAX_SMOOTHINGS = 500
RELAXATION = 0.5
"""Share of the way to the mean of its neighbours that a vertex goes in each smoothing."""


def with_rounded_edges(surface: trimesh.Trimesh, radius: float) -> trimesh.Trimesh:
    """Return the surface with its sharp edges rounded, about as by a fillet.

    The vertices near sharp edges are smoothed until as much volume is taken away (or, at inner edges, added) as by a
    fillet of that radius: ``radius^2 (tan(angle / 2) - angle / 2)`` per length of an edge, where ``angle`` is that
    between the normals of the two faces. The rest of the surface stays where it is. The cross-section is only nearly
    an arc.

    Args:
        surface: Closed, with outward normals.
        radius: Radius of the fillet [m].

    Raises:
        InvalidMeshError: If the radius is not positive, larger than a quarter of the object's shortest side, or so
            small that the surface would need more than ``MAX_TRIANGLES``.
    """
    import trimesh

    require_in_range(
        InvalidMeshError, "edge_radius", radius, 0.0, float(surface.extents.min()) / 4.0, low_open=True, unit="m"
    )
    edge_length = radius / EDGES_PER_RADIUS
    if surface.area / (REGULAR_TRIANGLE * edge_length**2) > MAX_TRIANGLES:
        smallest = EDGES_PER_RADIUS * (surface.area / (REGULAR_TRIANGLE * MAX_TRIANGLES)) ** 0.5
        raise InvalidMeshError(
            f"edge_radius = {radius:g} m is too small for this object; give at least {smallest:.2g} m"
        )
    if not (surface.face_adjacency_angles > SHARP_ANGLE).any():
        return surface
    fine = trimesh.Trimesh(
        *split_long_edges(surface.vertices, surface.faces, edge_length, 2 * MAX_TRIANGLES), process=False
    )
    is_sharp = fine.face_adjacency_angles > SHARP_ANGLE
    edges, angles = fine.face_adjacency_edges[is_sharp], fine.face_adjacency_angles[is_sharp]
    rim = np.unique(edges)
    start = np.asarray(fine.vertices)
    distance, _ = cKDTree(start[rim]).query(start)
    free = np.flatnonzero(distance < REACH * radius)

    count = len(start)
    pairs = np.concatenate([fine.edges_unique, fine.edges_unique[:, ::-1]])
    neighbours = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    mean_of_neighbours = neighbours.multiply(1.0 / neighbours.sum(axis=1)[:, None]).tocsr()[free]
    lengths = np.linalg.norm(start[edges[:, 1]] - start[edges[:, 0]], axis=1)
    wanted = float(radius**2 * ((np.tan(angles / 2.0) - angles / 2.0) * lengths).sum())
    areas = np.bincount(fine.faces.ravel(), np.repeat(fine.area_faces / 3.0, 3), minlength=count)[free]
    normals = fine.vertex_normals[free]
    positions = start.copy()
    for _ in range(MAX_SMOOTHINGS):
        positions[free] += RELAXATION * (mean_of_neighbours @ positions - positions[free])
        moved = np.einsum("vi,vi->v", positions[free] - start[free], normals)
        if areas @ np.abs(moved) >= wanted:
            break
    return trimesh.Trimesh(positions, fine.faces, process=False)


def _points_along(ends: np.ndarray, spacing: float) -> np.ndarray:
    """Return points on line segments ``(segment, 2, 3)``, no farther apart than the spacing [m]."""
    counts = np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / spacing).astype(int) + 1
    segment = np.repeat(np.arange(len(ends)), counts)
    first = np.cumsum(counts) - counts
    share = (np.arange(len(segment)) - first[segment]) / np.maximum(counts[segment] - 1, 1)
    return ends[segment, 0] + share[:, None] * (ends[segment, 1] - ends[segment, 0])
