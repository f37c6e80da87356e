"""A tetrahedral mesh and what follows from its geometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from defgrasp_ros.errors import InvalidMeshError

TET_FACES = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 3], [0, 3, 2]])
"""Faces of a positively oriented tetrahedron, seen from outside counter-clockwise."""

MIN_RELATIVE_VOLUME = 1e-7
"""An element smaller than this fraction of the cube of its longest edge has no usable stiffness."""


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Positively oriented tetrahedra over vertices in the object frame.

    Elements given with negative orientation are turned round; vertices that belong to no element are dropped.

    Args:
        vertices: Positions [m], shape ``(node, 3)``.
        tetrahedra: Vertex indices, shape ``(tet, 4)``.

    Raises:
        InvalidMeshError: If an array has the wrong shape, holds numbers that are not finite or indices out of
            range, if there is no element, or if an element has (almost) no volume.
    """

    vertices: np.ndarray
    tetrahedra: np.ndarray

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices, dtype=np.float64)
        tetrahedra = np.asarray(self.tetrahedra)
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
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "tetrahedra", tetrahedra)

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
        """Gradients of the four linear shape functions of each element [1/m], shape ``(tet, 4, 3)``."""
        p0, p1, p2, p3 = np.moveaxis(self.vertices[self.tetrahedra], 1, 0)
        inverse = np.linalg.inv(np.stack([p1 - p0, p2 - p0, p3 - p0], axis=-1))
        return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)

    @cached_property
    def node_volumes(self) -> np.ndarray:
        """A quarter of the adjacent elements' volume for each node [m^3], shape ``(node,)``."""
        return np.bincount(self.tetrahedra.ravel(), np.repeat(self.volumes / 4.0, 4), minlength=len(self.vertices))

    @cached_property
    def surface_triangles(self) -> np.ndarray:
        """Boundary faces, counter-clockwise from outside, shape ``(triangle, 3)``."""
        faces = self.tetrahedra[:, TET_FACES].reshape(-1, 3)
        _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return np.ascontiguousarray(faces[np.sort(first[counts == 1])])

    @cached_property
    def surface_nodes(self) -> np.ndarray:
        """Indices of the nodes on the boundary, ascending, shape ``(surface node,)``."""
        return np.unique(self.surface_triangles)

    @cached_property
    def surface_edges(self) -> np.ndarray:
        """Edges of the boundary faces, each once, shape ``(edge, 2)``, lower index first."""
        edges = self.surface_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        return np.unique(np.sort(edges, axis=1), axis=0)


def signed_volumes(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return (p1-p0) . ((p2-p0) x (p3-p0)) / 6 of each element [m^3], shape ``(tet,)``."""
    p0, p1, p2, p3 = np.moveaxis(vertices[tetrahedra], 1, 0)
    return np.einsum("ij,ij->i", p1 - p0, np.cross(p2 - p0, p3 - p0)) / 6.0
