"""Checks and mends the triangles of an object before they are filled with tetrahedra."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from defgrasp_ros.errors import InvalidMeshError, MeshNotWatertightError, MeshTooLargeError

if TYPE_CHECKING:
    import trimesh

MAX_TRIANGLES = 2_000_000
"""Larger surfaces are refused before any time is spent on them."""

MIN_RELATIVE_VOLUME = 1e-6
"""A surface that encloses less than this fraction of (area)^(3/2) is flat."""


def closed_surface(vertices: np.ndarray, triangles: np.ndarray) -> trimesh.Trimesh:
    """Return the boundary of a solid: closed, consistently oriented, normals pointing out.

    Vertices at the same place are merged, as formats without shared vertices and texture seams need it;
    triangles that are wound the wrong way, and surfaces that are inside out, are turned.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``.

    Raises:
        InvalidMeshError: If an array has the wrong shape, holds numbers that are not finite or indices out of
            range, or if the surface encloses no volume.
        MeshNotWatertightError: If there are holes.
        MeshTooLargeError: If there are more triangles than ``MAX_TRIANGLES``.
    """
    import trimesh

    vertices, triangles = _checked_arrays(vertices, triangles)
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    surface.merge_vertices(merge_tex=True, merge_norm=True)
    faces = surface.faces
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    surface.update_faces(~collapsed)
    if len(surface.faces) == 0:
        raise InvalidMeshError("the surface has only triangles without area")
    _require_closed(surface)
    if not _is_oriented(surface):
        trimesh.repair.fix_winding(surface)
        if not _is_oriented(surface):
            raise InvalidMeshError(
                "the triangles have no consistent inside and outside; give a surface in which every edge joins "
                "triangles of opposite winding"
            )
    with np.errstate(divide="ignore", invalid="ignore"):  # the volume comes with the centre of mass, divided by it
        volume = float(surface.volume)
    if volume < 0.0:
        surface.invert()
    if abs(volume) <= MIN_RELATIVE_VOLUME * surface.area**1.5:
        raise InvalidMeshError("the surface is closed but encloses no volume; a solid object is needed")
    return surface


def _checked_arrays(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(triangles)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InvalidMeshError(f"vertices have shape {vertices.shape}, expected (vertex, 3)")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise InvalidMeshError(
            f"triangles have shape {triangles.shape}, expected (triangle, 3) with at least one triangle"
        )
    if len(triangles) > MAX_TRIANGLES:
        raise MeshTooLargeError(f"the surface has {len(triangles)} triangles, more than {MAX_TRIANGLES}; decimate it")
    if not np.isfinite(vertices).all():
        raise InvalidMeshError(f"vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])} is not finite")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        worst = triangles.max() if triangles.max() >= len(vertices) else triangles.min()
        raise InvalidMeshError(f"triangles contain index {worst}, but the surface has {len(vertices)} vertices")
    return vertices, triangles.astype(np.int64)


def _require_closed(surface: trimesh.Trimesh) -> None:
    """Raise if an edge belongs to an odd number of triangles; say how many holes there are, and where."""
    edges, counts = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    open_edges = edges[counts % 2 == 1]
    if len(open_edges) == 0:
        return
    nodes, local = np.unique(open_edges, return_inverse=True)
    start, end = local.reshape(-1, 2).T
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(len(nodes), len(nodes)))
    hole_count, hole_of_node = connected_components(graph, directed=False)
    rims = [surface.vertices[nodes[hole_of_node == hole]] for hole in range(hole_count)]
    largest = max(rims, key=lambda rim: np.linalg.norm(np.ptp(rim, axis=0)))
    x, y, z = largest.mean(axis=0)
    raise MeshNotWatertightError(
        f"the surface is not watertight: {len(open_edges)} boundary edges around {hole_count} "
        f"hole{'s' if hole_count > 1 else ''}, the largest {np.linalg.norm(np.ptp(largest, axis=0)):.3g} m across "
        f"near ({x:.4g}, {y:.4g}, {z:.4g}) m; close it in a mesh editor, or with trimesh.repair.fill_holes"
    )


def _is_oriented(surface: trimesh.Trimesh) -> bool:
    """Whether each edge is run through equally often in both directions."""
    _, inverse = np.unique(surface.edges_sorted, axis=0, return_inverse=True)
    direction = np.where(surface.edges[:, 0] < surface.edges[:, 1], 1, -1)
    return not np.bincount(inverse.ravel(), direction).any()
