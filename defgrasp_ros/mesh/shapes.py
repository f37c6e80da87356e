"""Object shapes made by formulae: a block for calculations that can be checked, a kidney for demonstrations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from defgrasp_ros.mesh.tet_mesh import TetMesh

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners of the unit cell; corner number 4 i + 2 j + k."""

EVEN_CELL = np.array([[0, 3, 5, 6], [1, 0, 3, 5], [2, 0, 3, 6], [4, 0, 5, 6], [7, 3, 5, 6]])
"""Five tetrahedra that fill a cell, with the face diagonals through corner 0."""

ODD_CELL = 7 - EVEN_CELL
"""The same, mirrored, with the other face diagonals: neighbours of an even cell."""


def box(extents: Sequence[float], cells: Sequence[int]) -> TetMesh:
    """Return a block centred at the origin, with nodes on a regular grid.

    Args:
        extents: Edge lengths along x, y, z [m].
        cells: Number of grid cells along x, y, z; each is cut into five tetrahedra, mirrored from cell to cell.
    """
    nodes = np.array(cells) + 1
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in nodes), indexing="ij"), axis=-1).reshape(-1, 3)
    cell = grid[(grid < cells).all(axis=1)]
    corner_nodes = np.ravel_multi_index(np.moveaxis(cell[:, None] + CORNERS, -1, 0), tuple(nodes))
    is_odd = cell.sum(axis=1) % 2 == 1
    tetrahedra = np.where(is_odd[:, None, None], corner_nodes[:, ODD_CELL], corner_nodes[:, EVEN_CELL])
    return TetMesh((grid / cells - 0.5) * extents, tetrahedra.reshape(-1, 4))


def kidney_surface() -> tuple[np.ndarray, np.ndarray]:
    """Return the surface of a kidney lying on its side: 98 x 48 x 39 mm, tapered, bent, hollowed on one side.

    It stands on a flat base in the plane z = 0 and is long in x; the hollow side faces -y.

    Returns:
        Vertices [m], shape ``(vertex, 3)``, and triangles, counter-clockwise from outside, shape ``(triangle, 3)``.
    """
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=4)
    along, across, up = sphere.vertices.T
    taper = 1.0 + 0.16 * along
    x = 0.049 * along
    y = 0.023 * across * taper - 0.014 * along**2
    z = 0.0215 * up * taper
    hollow = np.exp(-((along / 0.35) ** 2) - ((across + 1.0) / 0.5) ** 2)
    y += 0.009 * hollow
    return np.column_stack([x, y, _flattened(z, base=-0.017, blend=0.003)]), np.asarray(sphere.faces)


def _flattened(z: np.ndarray, base: float, blend: float) -> np.ndarray:
    """Return heights above ``base``, with what is below pressed flat; smooth over +-``blend``."""
    height = z - base
    rounded = (height + blend) ** 2 / (4.0 * blend)
    return np.where(height > blend, height, np.where(height < -blend, 0.0, rounded))
