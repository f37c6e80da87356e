"""From triangles or ready tetrahedra to a mesh that can be simulated, with all checks on the way."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError
from defgrasp_ros.mesh.quality import dihedral_angles
from defgrasp_ros.mesh.surface import closed_surface
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.mesh.tetrahedralize import MAX_TETRAHEDRA, tetrahedralize

MIN_EXTENT, MAX_EXTENT = 0.001, 2.0
"""Longest side of the bounding box [m] that an object for a gripper can have; outside, the unit is wrong."""

SPECK_FRACTION = 0.01
"""Loose parts below this fraction of the volume are dirt of a scan and are left out."""

POOR_DIHEDRAL_ANGLE = np.radians(2.0)
"""Elements with a smaller angle [rad] are reported: they spoil the solution around them."""

MAX_NODES = 7_000
"""Each dense inverse of the simulation takes 3.5 GB with so many; elements of order 2 reach it first."""

logger = logging.getLogger(__name__)


def mesh_from_surface(
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    scale: float = 1.0,
    target_edge_length: float | None = None,
    element_order: int = 1,
) -> TetMesh:
    """Return the solid inside a surface.

    Args:
        vertices: Positions, in metres after multiplication with ``scale``, shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``; the surface must be closed.
        scale: Factor to metres, e.g. 0.001 for millimetres.
        target_edge_length: Edge length of the tetrahedra [m]; None: for about 1 000 nodes.
        element_order: 1 or 2, see :class:`TetMesh`.

    Raises:
        InvalidMeshError: If the surface is no solid of plausible size; of a class that says which fault it is.
    """
    vertices = _scaled(vertices, scale)
    _require_plausible_size(vertices)
    surface = closed_surface(vertices, triangles)
    mesh = tetrahedralize(surface.vertices, surface.faces, target_edge_length, element_order)
    return _checked(mesh, element_order)


def mesh_from_tetrahedra(
    vertices: np.ndarray, tetrahedra: np.ndarray, *, scale: float = 1.0, element_order: int = 1
) -> TetMesh:
    """Return ready tetrahedra as they are, checked.

    Args:
        vertices: Positions, in metres after multiplication with ``scale``, shape ``(vertex, 3)``.
        tetrahedra: Vertex indices, shape ``(tet, 4)``.
        scale: Factor to metres, e.g. 0.001 for millimetres.
        element_order: 1 or 2; order 2 adds the middles of the edges to the given vertices.

    Raises:
        InvalidMeshError: If they are no solid of plausible size.
    """
    if len(tetrahedra) > MAX_TETRAHEDRA:
        raise MeshTooLargeError(
            f"the mesh has {len(tetrahedra)} tetrahedra, more than {MAX_TETRAHEDRA}; mesh it coarser"
        )
    vertices = _scaled(vertices, scale)
    _require_plausible_size(vertices)
    return _checked(TetMesh(vertices, tetrahedra), element_order)


def _scaled(vertices: np.ndarray, scale: float) -> np.ndarray:
    factor = require_in_range(InvalidMeshError, "scale", scale, 0.0, low_open=True)
    return np.asarray(vertices, dtype=np.float64) * factor


def _require_plausible_size(vertices: np.ndarray) -> None:
    if vertices.shape[1:] != (3,) or len(vertices) == 0 or not np.isfinite(vertices).all():
        return  # the arrays themselves are wrong; whoever reads them says how
    extents = np.ptp(vertices, axis=0)
    if not MIN_EXTENT <= extents.max() <= MAX_EXTENT:
        sides = " x ".join(f"{extent:.3g}" for extent in extents)
        raise InvalidMeshError(
            f"the object measures {sides} m, but its longest side must be between {MIN_EXTENT:g} and {MAX_EXTENT:g} m: "
            "the unit looks wrong; lengths are metres, so give scale=0.001 for a file in millimetres"
        )


def _checked(mesh: TetMesh, element_order: int) -> TetMesh:
    mesh = replace(_largest_body(mesh), element_order=element_order)
    if len(mesh.tetrahedra) > MAX_TETRAHEDRA:
        raise MeshTooLargeError(
            f"the mesh has {len(mesh.tetrahedra)} tetrahedra, more than {MAX_TETRAHEDRA}; "
            "give a larger target_edge_length"
        )
    if len(mesh.vertices) > MAX_NODES:
        raise MeshTooLargeError(
            f"the mesh has {len(mesh.vertices)} nodes at element_order = {mesh.element_order}, more than {MAX_NODES}; "
            "mesh it coarser"
        )
    angles = dihedral_angles(mesh).min(axis=1)
    poor = angles < POOR_DIHEDRAL_ANGLE
    if poor.any():
        logger.warning(
            "%d of %d tetrahedra are almost flat (smallest dihedral angle %.2g deg): "
            "expect slow convergence and wrong stresses there",
            poor.sum(),
            len(poor),
            np.degrees(angles.min()),
        )
    return mesh


def _largest_body(mesh: TetMesh) -> TetMesh:
    """Return the mesh without specks; bodies that are not joined cannot be one object."""
    edges = mesh.tetrahedra[:, [[0, 1], [0, 2], [0, 3]]].reshape(-1, 2)
    size = len(mesh.vertices)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(size, size))
    count, body_of_node = connected_components(graph, directed=False)
    if count == 1:
        return mesh
    body = body_of_node[mesh.tetrahedra[:, 0]]
    volumes = np.bincount(body, mesh.volumes)
    rest = 1.0 - volumes.max() / volumes.sum()
    if rest > SPECK_FRACTION:
        listed = ", ".join(f"{volume * 1e6:.3g}" for volume in np.sort(volumes)[:-6:-1])
        raise InvalidMeshError(
            f"the object consists of {count} bodies that are not joined ({listed}{', ...' if count > 5 else ''} cm^3); "
            "a grasped object is one body: unite them, or keep one"
        )
    logger.warning("left out %d loose specks, together %.2g %% of the volume", count - 1, 100.0 * rest)
    return TetMesh(mesh.vertices, mesh.tetrahedra[body == volumes.argmax()])
