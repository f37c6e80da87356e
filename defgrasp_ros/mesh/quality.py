"""How well shaped the elements of a mesh are."""

from __future__ import annotations

import numpy as np

from defgrasp_ros.mesh.tet_mesh import TET_FACES, TetMesh

FACE_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def dihedral_angles(mesh: TetMesh) -> np.ndarray:
    """Return the six angles between the faces of each element [rad], shape ``(tet, 6)``.

    A regular tetrahedron has 1.231 rad (70.5 deg) six times; an element is nearly flat where an angle is close
    to 0 or pi, and then the stiffness matrix is ill conditioned.
    """
    a, b, c = np.moveaxis(mesh.vertices[mesh.tetrahedra[:, TET_FACES]], 2, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    first, second = normals[:, FACE_PAIRS[:, 0]], normals[:, FACE_PAIRS[:, 1]]
    # atan2 keeps its precision near 0 and pi, where arccos loses half of the digits.
    sine = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.arctan2(sine, -np.einsum("tpi,tpi->tp", first, second))


def aspect_ratios(mesh: TetMesh) -> np.ndarray:
    """Return longest edge / (2 sqrt(6) x inradius) of each element [-], shape ``(tet,)``; 1 for a regular one."""
    corners = mesh.vertices[mesh.tetrahedra]
    longest = np.linalg.norm(corners[:, :, None] - corners[:, None, :], axis=-1).max(axis=(1, 2))
    a, b, c = np.moveaxis(corners[:, TET_FACES], 2, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum(axis=1) / 2.0
    return longest * areas / (2.0 * 6.0**0.5 * 3.0 * mesh.volumes)
