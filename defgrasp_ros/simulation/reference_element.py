"""Shape functions and quadrature of straight-sided tetrahedra, by element order, in barycentric coordinates L.

Order 1: N_a = L_a, one point. Order 2: N_a = L_a (2 L_a - 1) at corners, 4 L_a L_b at the middles of edges, and the
four points of degree 2 (Hammer, Marlowe & Stroud 1956), which integrate the rest stiffness exactly. All points of a
rule weigh the same. The sides are straight, so the gradients follow from those of the barycentric coordinates:

    grad N_a = sum_b dN_a/dL_b grad L_b.

The mass of order 1 is lumped, which makes up for a part of its excess of stiffness. That of order 2 is consistent: a
positive lumping on its nodes is exact for linear motion only, and costs it most of its accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defgrasp_ros.mesh.tet_mesh import TET_EDGES


@dataclass(frozen=True, eq=False)
class ReferenceElement:
    """Tables of one element order."""

    points: np.ndarray
    """Barycentric coordinates of the quadrature points [-], shape ``(point, 4)``."""
    derivatives: np.ndarray
    """dN_a/dL_b at each of them [-], shape ``(point, node, 4)``."""
    mass: np.ndarray
    """Mass matrix of an element of mass 1 [-], shape ``(node, node)``; the entries sum up to 1."""

    @property
    def point_count(self) -> int:
        """Number of quadrature points."""
        return self.derivatives.shape[0]

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return self.derivatives.shape[1]

    def gradients(self, barycentric_gradients: np.ndarray) -> np.ndarray:
        """Return the gradients of the shape functions [1/m], shape ``(tet, point, node, 3)``.

        Args:
            barycentric_gradients: ``TetMesh.shape_gradients`` [1/m], shape ``(tet, 4, 3)``.
        """
        return np.einsum("qab,tbi->tqai", self.derivatives, barycentric_gradients)


def _quadratic_derivatives(points: np.ndarray) -> np.ndarray:
    derivatives = np.zeros((len(points), 10, 4))
    for corner in range(4):
        derivatives[:, corner, corner] = 4.0 * points[:, corner] - 1.0
    for edge, (a, b) in enumerate(TET_EDGES):
        derivatives[:, 4 + edge, a] = 4.0 * points[:, b]
        derivatives[:, 4 + edge, b] = 4.0 * points[:, a]
    return derivatives


def _quadratic_mass() -> np.ndarray:
    """Return the integrals of N_a N_b over an element of volume 1."""
    corners = np.array([{corner} for corner in range(4)] + [set(edge) for edge in TET_EDGES.tolist()])
    common = np.array([[len(a & b) for b in corners] for a in corners])
    mass = np.empty((10, 10))
    mass[:4, :4] = np.array([1.0, 6.0])[common[:4, :4]]
    mass[:4, 4:] = np.array([-6.0, -4.0])[common[:4, 4:]]
    mass[4:, :4] = mass[:4, 4:].T
    mass[4:, 4:] = np.array([8.0, 16.0, 32.0])[common[4:, 4:]]
    return mass / 420.0


_NEAR, _FAR = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0, (5.0 - np.sqrt(5.0)) / 20.0
_FOUR_POINTS = np.full((4, 4), _FAR) + (_NEAR - _FAR) * np.eye(4)

REFERENCE_ELEMENTS = {
    1: ReferenceElement(np.full((1, 4), 0.25), np.eye(4)[None], 0.25 * np.eye(4)),
    2: ReferenceElement(_FOUR_POINTS, _quadratic_derivatives(_FOUR_POINTS), _quadratic_mass()),
}
"""By element order."""
