"""The bodies of the experiments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel

JITTER = 0.15
"""Largest shift of an inner node of a jittered block along each axis, relative to the cell [-]."""


def block(
    extents: Sequence[float], cells: Sequence[int], material: Material | None = None, *, jittered: bool = False
) -> ObjectModel:
    """Return a block of a regular grid; jittered, its inner nodes are moved so that no element is special."""
    mesh = box(extents, cells)
    if jittered:
        inner = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.surface_nodes)
        shift = JITTER * np.random.default_rng(0).uniform(-1.0, 1.0, (len(inner), 3)) * np.divide(extents, cells)
        vertices = mesh.vertices.copy()
        vertices[inner] += shift
        mesh = TetMesh(vertices, mesh.tetrahedra)
    return ObjectModel("block", mesh, material or Material())


def on_face(model: ObjectModel, axis: int, side: int) -> np.ndarray:
    """Return which nodes lie on a face of the bounding box, e.g. axis 1, side -1: smallest y."""
    coordinate = side * model.mesh.vertices[:, axis]
    return coordinate > coordinate.max() - 1e-6 * model.mesh.extents[axis]


def extrapolated(coarse: float, fine: float, ratio: float = 2.0, order: int = 2) -> float:
    """Return Richardson's limit of two values with cells in the given ratio and errors of the given order."""
    factor = ratio**order
    return (factor * fine - coarse) / (factor - 1.0)
