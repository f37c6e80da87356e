"""A tetrahedral mesh and what follows from its geometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from defgrasp_ros.errors import InvalidMeshError

TET_FACES = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 3], [0, 3, 2]])
"""Faces of a positively oriented tetrahedron, seen from outside counter-clockwise."""

TET_EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Edges of a tetrahedron in the order of their middle nodes, local nodes 4 to 9, as in VTK and Abaqus (C3D10)."""

LUMPED_SHARES = {1: np.full(4, 1.0 / 4.0), 2: np.array([1.0 / 36.0] * 4 + [4.0 / 27.0] * 6)}
"""Share of an element's volume that each of its nodes carries, by element order.

Order 2: the diagonal of the consistent mass, scaled to the whole (Hinton, Rock & Zienkiewicz 1976); row sums would be
negative at the corners.
"""

DEFAULT_ELEMENT_ORDER = 2
"""Of tetrahedra that are made here: at equal node counts order 2 is the more accurate one. Tetrahedra that are given
are taken as they are."""

MIN_RELATIVE_VOLUME = 1e-7
"""An element smaller than this fraction of the cube of its longest edge has no usable stiffness."""


def _quartered(face: np.ndarray) -> list[list[int]]:
    """Return the four triangles between the corners of a face and the middles of its edges, as local nodes."""
    middle = {tuple(sorted(edge)): 4 + number for number, edge in enumerate(TET_EDGES.tolist())}
    a, b, c = face.tolist()
    ab, bc, ca = (middle[tuple(sorted(edge))] for edge in ((a, b), (b, c), (c, a)))
    return [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]


TET_FACES_QUARTERED = np.array([_quartered(face) for face in TET_FACES])
"""The faces of a ten-node tetrahedron as four triangles each, shape ``(face, 4, 3)``."""


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Positively oriented, straight-sided tetrahedra over nodes in the object frame.

    Elements given with negative orientation are turned round; vertices that belong to no element are dropped. With
    element order 2 the middles of all edges are appended to the vertices as further nodes. To change the order of a
    mesh: ``dataclasses.replace(mesh, element_order=2)``.

    Args:
        vertices: Positions [m], shape ``(node, 3)``; of a made mesh all nodes, corners first.
        tetrahedra: Indices of the corners, shape ``(tet, 4)``.
        element_order: Degree of the displacement in an element: 1 (four nodes) or 2 (ten nodes).

    Raises:
        InvalidMeshError: If an array has the wrong shape, holds numbers that are not finite or indices out of
            range, if there is no element, if an element has (almost) no volume, or if there is no such order.
    """

    vertices: np.ndarray
    tetrahedra: np.ndarray
    element_order: int = 1

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices, dtype=np.float64)
        tetrahedra = np.asarray(self.tetrahedra)
        require_element_order(self.element_order)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InvalidMeshError(f"vertices have shape {vertices.shape}, expected (node, 3)")
        if tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4 or len(tetrahedra) == 0:
            raise InvalidMeshError(f"tetrahedra have shape {tetrahedra.shape}, expected (tet, 4) with at least one tet")
        if not np.isfinite(vertices).all():
            raise InvalidMeshError(f"vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])} is not finite")
        if tetrahedra.min() < 0 or tetrahedra.max() >= len(vertices):
            worst = tetrahedra.max() if tetrahedra.max() >= len(vertices) else tetrahedra.min()
            raise InvalidMeshError(f"tetrahedra contain index {worst}, but the mesh has {len(vertices)} vertices")
        used, inverse = np.unique(tetrahedra, return_inverse=True)
        vertices = np.ascontiguousarray(vertices[used])
        tetrahedra = inverse.reshape(tetrahedra.shape).astype(np.int32)

        volumes = signed_volumes(vertices, tetrahedra)
        negative = volumes < 0.0
        tetrahedra[negative] = tetrahedra[negative][:, [0, 2, 1, 3]]
        corners = vertices[tetrahedra]
        longest = np.linalg.norm(corners[:, :, None] - corners[:, None, :], axis=-1).max(axis=(1, 2))
        flat = np.abs(volumes) <= MIN_RELATIVE_VOLUME * longest**3
        if flat.any():
            raise InvalidMeshError(
                f"{int(flat.sum())} of {len(tetrahedra)} tetrahedra have no volume (first: element "
                f"{int(np.argmax(flat))}); mesh the surface again, or remove these elements"
            )
        if self.element_order == 2:
            ends, _ = _unique_edges(tetrahedra)
            vertices = np.concatenate([vertices, vertices[ends].mean(axis=1)])
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "tetrahedra", tetrahedra)

    @property
    def corners(self) -> np.ndarray:
        """Positions of the nodes that are corners of elements [m], shape ``(corner, 3)``."""
        return self.vertices[: self.tetrahedra.max() + 1]

    @cached_property
    def elements(self) -> np.ndarray:
        """Nodes of each element, shape ``(tet, 4)``, or ``(tet, 10)``: corners, then the middles of ``TET_EDGES``."""
        if self.element_order == 1:
            return self.tetrahedra
        ends, edges = _unique_edges(self.tetrahedra)
        return np.concatenate([self.tetrahedra, len(self.vertices) - len(ends) + edges], axis=1, dtype=np.int32)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volume of each element [m^3], shape ``(tet,)``, positive."""
        return signed_volumes(self.vertices, self.tetrahedra)

    @property
    def volume(self) -> float:
        """Volume of the solid [m^3]."""
        return float(self.volumes.sum())

    @property
    def extents(self) -> np.ndarray:
        """Edge lengths of the axis-aligned bounding box [m], shape ``(3,)``."""
        return np.ptp(self.vertices, axis=0)

    @property
    def size(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(self.extents))

    @cached_property
    def shape_gradients(self) -> np.ndarray:
        """Gradients of the four barycentric coordinates of each element [1/m], shape ``(tet, 4, 3)``."""
        p0, p1, p2, p3 = np.moveaxis(self.vertices[self.tetrahedra], 1, 0)
        inverse = np.linalg.inv(np.stack([p1 - p0, p2 - p0, p3 - p0], axis=-1))
        return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)

    @cached_property
    def node_volumes(self) -> np.ndarray:
        """The volume that each node carries [m^3], shape ``(node,)``, positive; shares of the adjacent elements."""
        shares = self.volumes[:, None] * LUMPED_SHARES[self.element_order]
        return np.bincount(self.elements.ravel(), shares.ravel(), minlength=len(self.vertices))

    def nodal_mean(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of the adjacent elements' values, weighted by volume, shape ``(node,)``.

        Args:
            values: One per element, shape ``(tet,)``.
        """
        nodes, count = self.elements.ravel(), self.elements.shape[1]
        volume = np.bincount(nodes, np.repeat(self.volumes, count), minlength=len(self.vertices))
        total = np.bincount(nodes, np.repeat(self.volumes * values, count), minlength=len(self.vertices))
        return total / volume

    @cached_property
    def surface_triangles(self) -> np.ndarray:
        """Flat boundary faces, counter-clockwise from outside, shape ``(triangle, 3)``.

        A face of order 2 is given as the four triangles between its six nodes.
        """
        local = TET_FACES if self.element_order == 1 else TET_FACES_QUARTERED
        faces = np.sort(self.tetrahedra[:, TET_FACES].reshape(-1, 3), axis=1)
        _, first, counts = np.unique(faces, axis=0, return_index=True, return_counts=True)
        boundary = np.sort(first[counts == 1])
        triangles = self.elements[:, local].reshape(len(faces), -1, 3)[boundary]
        return np.ascontiguousarray(triangles.reshape(-1, 3))

    @cached_property
    def surface_nodes(self) -> np.ndarray:
        """Indices of the nodes on the boundary, ascending, shape ``(surface node,)``."""
        return np.unique(self.surface_triangles)

    @cached_property
    def surface_edges(self) -> np.ndarray:
        """Edges of the boundary faces, each once, shape ``(edge, 2)``, lower index first."""
        edges = self.surface_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        return np.unique(np.sort(edges, axis=1), axis=0)


def require_element_order(element_order: int) -> int:
    """Return the order.

    Raises:
        InvalidMeshError: If there are no elements of that order.
    """
    if element_order not in LUMPED_SHARES:
        raise InvalidMeshError(f"element_order = {element_order} is not available; give 1 or 2")
    return element_order


def made_element_order(element_order: int | None) -> int:
    """Return the order of tetrahedra that are made here: the one asked for, or ``DEFAULT_ELEMENT_ORDER`` for None.

    Raises:
        InvalidMeshError: If there are no elements of that order.
    """
    return require_element_order(DEFAULT_ELEMENT_ORDER if element_order is None else element_order)


def signed_volumes(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return (p1-p0) . ((p2-p0) x (p3-p0)) / 6 of each element [m^3], shape ``(tet,)``."""
    p0, p1, p2, p3 = np.moveaxis(vertices[tetrahedra], 1, 0)
    return np.einsum("ij,ij->i", p1 - p0, np.cross(p2 - p0, p3 - p0)) / 6.0


def _unique_edges(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of each edge, shape ``(edge, 2)``, and each element's edges, shape ``(tet, 6)``."""
    ends = np.sort(tetrahedra[:, TET_EDGES].reshape(-1, 2), axis=1)
    unique, edges = np.unique(ends, axis=0, return_inverse=True)
    return unique, edges.reshape(-1, len(TET_EDGES))
