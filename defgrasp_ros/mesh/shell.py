"""Hollow objects: a wall of given thickness inside of a surface, as tetrahedra in layers.

A mesher that fills the space between two surfaces needs elements as small as the wall is thick. Here the triangles of
the outer surface are carried through the wall instead, each as prisms of three tetrahedra, so that the number of
elements does not depend on the thickness. The surface may be open, as that of a cup: its rim becomes an edge.
"""

from __future__ import annotations

import numpy as np

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, TetrahedralizationError
from defgrasp_ros.mesh.node_count import DEFAULT_NODES, with_nodes
from defgrasp_ros.mesh.overlap import enclosed_volume
from defgrasp_ros.mesh.surface_geometry import triangle_normals
from defgrasp_ros.mesh.tet_mesh import DEFAULT_ELEMENT_ORDER, TetMesh, signed_volumes
from defgrasp_ros.mesh.triangle_size import REGULAR_TRIANGLE, with_triangle_size

LAYERS = {1: 2, 2: 1}
"""Elements through the thickness, by element order: one of order 1 alone cannot bend, as the strain in it is
constant."""

NODES_PER_VERTEX = {1: 3, 2: 12}
"""Nodes of the wall for each vertex of the surface, by element order."""

FLAT_SPREAD = 0.05
"""Directions in which the normals around a vertex spread less than this count as flat: the wall is offset along the
mean normal there. Larger spreads are edges and corners, at which it is offset so that all faces keep their distance."""

MAX_STRETCH = 3.0
"""Largest offset of a vertex, in thicknesses; where faces meet more sharply the wall is thinner."""

TOO_FINE = 1.4
"""Factor on an edge length with which the wall does not fit, in the search for a default: edges must not be much
shorter than a curved wall is thick."""

MAX_OVERLAP = 0.01
"""Share of the volume up to which parts of the wall may seem to overlap; measuring is no finer."""


def shell_mesh(
    vertices: np.ndarray,
    triangles: np.ndarray,
    thickness: float,
    target_edge_length: float | None = None,
    element_order: int = DEFAULT_ELEMENT_ORDER,
) -> TetMesh:
    """Return the wall inside of a surface.

    Args:
        vertices: Positions on the outside of the wall [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``; open or closed, but
            without an edge of more than two triangles. A closed surface that is inside out is turned.
        thickness: Of the wall [m].
        target_edge_length: Edge length of the triangles [m]; None: for about 1 000 nodes.
        element_order: Of the elements that the mesh is for.

    Raises:
        InvalidMeshError: If a number is outside its range or the surface has no two sides.
        TetrahedralizationError: If the wall is too thick for the surface: parts of it meet.
    """
    import trimesh

    surface = trimesh.Trimesh(vertices, triangles, process=False)
    if not surface.is_winding_consistent:
        trimesh.repair.fix_winding(surface)
    if not surface.is_winding_consistent:
        raise InvalidMeshError("the surface has no two sides: give one whose edges belong to one or two triangles")
    if surface.is_watertight and surface.volume < 0.0:
        surface.invert()
    require_in_range(
        InvalidMeshError, "wall_thickness", thickness, 0.0, surface.extents.max() / 2.0, low_open=True, unit="m"
    )
    layers = LAYERS[element_order]

    def wall(edge_length: float) -> TetMesh:
        outside = with_triangle_size(surface, edge_length)
        return layered_wall(np.asarray(outside.vertices), np.asarray(outside.faces), thickness, layers)

    if target_edge_length is None:
        faces = 2.0 * DEFAULT_NODES / NODES_PER_VERTEX[element_order]
        first = float((surface.area / (REGULAR_TRIANGLE * faces)) ** 0.5)
        return with_nodes(wall, first, element_order, TOO_FINE)
    require_in_range(
        InvalidMeshError, "target_edge_length", target_edge_length, 0.0, surface.extents.max(), low_open=True, unit="m"
    )
    return wall(target_edge_length)


def layered_wall(vertices: np.ndarray, triangles: np.ndarray, thickness: float, layers: int) -> TetMesh:
    """Return the wall inside of a surface, with the triangles as they are.

    Args:
        vertices: Positions on the outside of the wall [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``.
        thickness: Of the wall [m].
        layers: Elements through the thickness.

    Raises:
        TetrahedralizationError: If parts of the wall meet.
    """
    inward = -_offsets(vertices, triangles)
    positions = np.concatenate([vertices + thickness * layer / layers * inward for layer in range(layers + 1)])
    # Each quadrilateral between two prisms is cut from its lower to its higher vertex, so that both agree.
    ordered = np.sort(triangles, axis=1)
    parity = np.where(np.linalg.det(np.eye(3)[np.argsort(triangles, axis=1)]) > 0.0, 1.0, -1.0)
    tetrahedra, orientation = [], []
    for layer in range(layers):
        a, b, c = (ordered + layer * len(vertices)).T
        d, e, f = (ordered + (layer + 1) * len(vertices)).T
        for corners, sign in (((a, b, c, f), -1.0), ((a, b, f, e), -1.0), ((a, e, f, d), -1.0)):
            tetrahedra.append(np.column_stack(corners))
            orientation.append(sign * parity)
    elements = np.concatenate(tetrahedra)
    volumes = signed_volumes(positions, elements) * np.concatenate(orientation)
    if (volumes <= 0.0).any():
        raise TetrahedralizationError(
            f"a wall {thickness * 1e3:.3g} mm thick does not fit inside the surface: {int((volumes <= 0.0).sum())} of "
            f"{len(volumes)} elements are inside out where it is curved or sharp; give a thinner wall, a larger "
            "target_edge_length or a smoother surface"
        )
    mesh = TetMesh(positions, elements)
    enclosed = enclosed_volume(mesh.vertices, mesh.surface_triangles)
    if enclosed.overlap > MAX_OVERLAP * enclosed.union:
        raise TetrahedralizationError(
            f"a wall {thickness * 1e3:.3g} mm thick does not fit inside the surface: opposite walls meet; give a "
            "thinner wall, or leave out wall_thickness for a solid object"
        )
    return mesh


def _offsets(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return for each vertex the vector that moves all faces around it outwards by 1, shape ``(vertex, 3)``.

    It is the least-squares solution of ``normal . offset = 1`` for the faces around, weighted with their angles.
    """
    normals = triangle_normals(vertices, triangles)
    corners = vertices[triangles]
    forward, backward = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(forward, backward), axis=2)
    angles = np.arctan2(sine, np.einsum("tci,tci->tc", forward, backward))
    matrix, mean, total = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for corner in range(3):
        nodes, weight = triangles[:, corner], angles[:, corner]
        np.add.at(matrix, nodes, weight[:, None, None] * np.einsum("ti,tj->tij", normals, normals))
        np.add.at(mean, nodes, weight[:, None] * normals)
        np.add.at(total, nodes, weight)
    used = total > 0.0
    matrix[used] /= total[used, None, None]
    mean[used] /= total[used, None]
    values, directions = np.linalg.eigh(matrix)
    flat = values < FLAT_SPREAD
    inverse = np.where(flat, 0.0, 1.0 / np.where(flat, 1.0, values))
    components = np.einsum("vij,vi->vj", directions, mean)
    offsets = np.einsum("vij,vj->vi", directions, inverse * components)
    lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
    return offsets * np.minimum(1.0, MAX_STRETCH / np.maximum(lengths, 1e-12))
