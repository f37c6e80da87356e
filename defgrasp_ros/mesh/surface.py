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


MENDS = "mends"
"""Key of a surface's ``metadata`` under which is written what was mended, a list of texts."""

SMALL_HOLE = 0.05
"""Holes up to this size, relative to the diagonal of the bounding box, are gaps of a scan and are closed."""


def closed_surface(vertices: np.ndarray, triangles: np.ndarray) -> trimesh.Trimesh:
    """Return the boundary of a solid: closed, consistently oriented, normals pointing out.

    Vertices at the same place are merged, as formats without shared vertices and texture seams need it; triangles
    that are repeated or have no area are left out; small holes are closed; triangles that are wound the wrong way,
    and surfaces that are inside out, are turned. What was mended is listed in ``metadata[MENDS]``.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``.

    Raises:
        InvalidMeshError: If an array has the wrong shape, holds numbers that are not finite or indices out of
            range, or if the surface encloses no volume.
        MeshNotWatertightError: If there are holes.
        MeshTooLargeError: If there are more triangles than ``MAX_TRIANGLES``.
    """
    surface = open_surface(vertices, triangles)
    mends = surface.metadata[MENDS]
    closed = _close_small_holes(surface)
    if closed:
        mends.append(f"closed {closed} small hole{'s' if closed > 1 else ''}")
    _require_closed(surface)
    if not _is_oriented(surface):
        _turn_to_neighbours(surface)
    with np.errstate(divide="ignore", invalid="ignore"):  # the volume comes with the centre of mass, divided by it
        volume = float(surface.volume)
    if volume < 0.0:
        surface.invert()
        mends.append("turned the surface, which was inside out")
    if abs(volume) <= MIN_RELATIVE_VOLUME * surface.area**1.5:
        raise InvalidMeshError("the surface is closed but encloses no volume; a solid object is needed")
    return surface


def open_surface(vertices: np.ndarray, triangles: np.ndarray) -> trimesh.Trimesh:
    """Return a surface, with or without boundary, cleaned of what has no area: merged, without repeated triangles.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``.

    Raises:
        InvalidMeshError: If an array has the wrong shape, holds numbers that are not finite or indices out of
            range, or nothing has an area.
        MeshTooLargeError: If there are more triangles than ``MAX_TRIANGLES``.
    """
    import trimesh

    vertices, triangles = _checked_arrays(vertices, triangles)
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    mends: list[str] = []
    surface.metadata[MENDS] = mends
    surface.merge_vertices(merge_tex=True, merge_norm=True)
    faces = surface.faces
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    surface.update_faces(~collapsed)
    if len(surface.faces) == 0:
        raise InvalidMeshError("the surface has only triangles without area")
    distinct = _distinct(surface.faces)
    if not distinct.all():
        mends.append(f"left out {int((~distinct).sum())} triangles that were there twice")
        surface.update_faces(distinct)
    return surface


def _distinct(triangles: np.ndarray) -> np.ndarray:
    """Return which triangles are no repetition of an earlier one with the same winding, shape ``(triangle,)``."""
    first = triangles.argmin(axis=1)[:, None]
    rolled = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    _, index = np.unique(rolled, axis=0, return_index=True)
    keep = np.zeros(len(triangles), dtype=bool)
    keep[index] = True
    return keep


def _turn_to_neighbours(surface: trimesh.Trimesh) -> None:
    """Wind all triangles alike; raise where an edge of more than two triangles or a one-sided surface forbids it."""
    import trimesh

    before = surface.faces.copy()
    trimesh.repair.fix_winding(surface)
    if not _is_oriented(surface):
        raise InvalidMeshError(
            "the triangles have no consistent inside and outside; give a surface in which every edge joins "
            "triangles of opposite winding"
        )
    turned = int((surface.faces != before).any(axis=1).sum())
    surface.metadata[MENDS].append(
        f"turned {min(turned, len(before) - turned)} triangles that were wound the wrong way"
    )


def _close_small_holes(surface: trimesh.Trimesh) -> int:
    """Close holes with a fan about their middle where their rim is a simple loop; return how many."""
    edges = surface.edges
    _, inverse, counts = np.unique(surface.edges_sorted, axis=0, return_inverse=True, return_counts=True)
    rim = edges[counts[inverse.ravel()] == 1]
    if len(rim) == 0:
        return 0
    nodes, local = np.unique(rim, return_inverse=True)
    start, end = local.reshape(-1, 2).T
    simple = (np.bincount(start, minlength=len(nodes)) == 1) & (np.bincount(end, minlength=len(nodes)) == 1)
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(len(nodes), len(nodes)))
    hole_count, hole_of_node = connected_components(graph, directed=False)
    size = float(np.linalg.norm(surface.extents))
    vertices, faces = [surface.vertices], [surface.faces]
    closed = 0
    for hole in range(hole_count):
        members = hole_of_node == hole
        points = surface.vertices[nodes[members]]
        if not simple[members].all() or np.linalg.norm(np.ptp(points, axis=0)) > SMALL_HOLE * size:
            continue
        here = members[start]
        middle = np.full(int(here.sum()), len(surface.vertices) + closed)
        vertices.append(points.mean(axis=0, keepdims=True))
        faces.append(np.column_stack([rim[here][:, ::-1], middle]))
        closed += 1
    if closed:
        surface.vertices, surface.faces = np.concatenate(vertices), np.concatenate(faces)
    return closed


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
        f"near ({x:.4g}, {y:.4g}, {z:.4g}) m; close it in a mesh editor, or give "
        "wall_thickness if it is the outside of a hollow object that is open there"
    )


def _is_oriented(surface: trimesh.Trimesh) -> bool:
    """Whether each edge is run through equally often in both directions."""
    _, inverse = np.unique(surface.edges_sorted, axis=0, return_inverse=True)
    direction = np.where(surface.edges[:, 0] < surface.edges[:, 1], 1, -1)
    return not np.bincount(inverse.ravel(), direction).any()
