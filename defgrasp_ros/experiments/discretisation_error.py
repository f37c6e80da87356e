"""How far a stress field is from the one that an infinitely fine mesh would give: an estimate from the field itself.

The stress of finite elements jumps from element to element. A smooth stress field sigma* is fitted to it, and what the
two differ by stands for the error (Zienkiewicz and Zhu 1992, superconvergent patch recovery):

    |e|^2 = 1/2 integral of (sigma* - sigma) : C^-1 : (sigma* - sigma),      relative error = |e| / sqrt(U + |e|^2).

Where the exact stress is singular, as at a pad's sharp edge, the estimate sees the error around the singularity, but no
bound of the peak. Nothing here simulates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse

from defgrasp_ros.experiments.metrics import von_mises_stress
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.tet_mesh import TET_EDGES, TetMesh
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS

POINTS_PER_TERM = 3.0
"""Stress points in a patch, at least, relative to the terms of the polynomial that is fitted to them [-]."""


@dataclass(frozen=True)
class DiscretisationError:
    """Estimated errors of one state."""

    energy_norm: float
    """|e| / sqrt(U + |e|^2) [-]: the relative error of the stress, all over the object."""
    stress: float
    """sqrt(2 E |e|^2 / V) [Pa]: the uniaxial stress which, even all over the object, has the energy of the error."""
    peak_von_mises_stress: float
    """Difference between the largest recovered and the largest computed von Mises stress [Pa], never negative."""

    @property
    def deformation(self) -> float:
        """Relative error of the largest nodal deformation [-].

        The error of a linear functional of the displacement is at most |e| times the energy norm of the error of its
        dual problem; relative to the functional, that is the relative error of both multiplied. The dual of a node's
        displacement is the object under a force at that node, which no mesh resolves: nothing is gained from it. Where
        the load is even and smooth, the deformation follows the load, its dual is as good as the state itself, and
        this estimate is too large by 1 / energy_norm.
        """
        return self.energy_norm


class StressRecovery:
    """The fit of a smooth stress field for one mesh; made once, used for every state.

    Args:
        mesh: Elements of either order.
    """

    def __init__(self, mesh: TetMesh):
        self._mesh = mesh
        self._reference = REFERENCE_ELEMENTS[mesh.element_order]

    def nodal_stress(self, stress: np.ndarray) -> np.ndarray:
        """Return the recovered stress at the nodes [Pa], shape ``(node, 3, 3)``.

        Args:
            stress: At the quadrature points [Pa], of ``Simulator.point_stresses``, shape ``(tet, point, 3, 3)``.
        """
        return (self._fit @ stress.reshape(-1, 9)).reshape(-1, 3, 3)

    def error(self, stress: np.ndarray, material: Material) -> DiscretisationError:
        """Estimate the error of a state.

        Args:
            stress: At the quadrature points [Pa], shape ``(tet, point, 3, 3)``.
            material: Of the object.
        """
        recovered = self.nodal_stress(stress)
        computed = np.einsum("aq,tqij->taij", self._to_nodes, stress)
        squared = self._energy(recovered[self._mesh.elements] - computed, material)
        total = self._energy(computed, material) + squared
        peak = von_mises_stress(recovered).max() - von_mises_stress(stress).max()
        return DiscretisationError(
            energy_norm=float(np.sqrt(squared / total)) if total > 0.0 else 0.0,
            stress=float(np.sqrt(2.0 * material.youngs_modulus * squared / self._mesh.volume)),
            peak_von_mises_stress=abs(float(peak)),
        )

    def _energy(self, stress: np.ndarray, material: Material) -> float:
        """1/2 integral of sigma : C^-1 : sigma of a field given at the elements' nodes [J]; exact."""
        modulus, ratio = material.youngs_modulus, material.poissons_ratio
        products = np.einsum("taij,tbij->tab", stress, stress)
        traces = np.trace(stress, axis1=-2, axis2=-1)
        density = (1.0 + ratio) * products - ratio * np.einsum("ta,tb->tab", traces, traces)
        consistent = (np.ones((4, 4)) + np.eye(4)) / 20.0 if self._mesh.element_order == 1 else self._reference.mass
        return float(np.einsum("t,tab,ab->", self._mesh.volumes, density, consistent)) / (2.0 * modulus)

    @cached_property
    def _to_nodes(self) -> np.ndarray:
        """Weights with which the points' stresses give those of the element's own field at its nodes."""
        if self._mesh.element_order == 1:
            return np.ones((4, 1))
        corners = np.linalg.inv(self._reference.points)
        return np.concatenate([corners, corners[TET_EDGES].mean(axis=1)])

    @cached_property
    def _fit(self) -> scipy.sparse.csr_matrix:
        """Weights of the points' stresses in each node's recovered stress, shape ``(node, tet x point)``.

        A polynomial of the elements' degree is fitted to the points of the elements around a node. A patch with too
        few of them, as on an edge of the object, takes the next layer of elements in.
        """
        mesh, points = self._mesh, self._reference.point_count
        places = np.einsum("qa,tai->tqi", self._reference.points, mesh.vertices[mesh.tetrahedra]).reshape(-1, 3)
        nodes, tets = mesh.elements.ravel(), np.repeat(np.arange(len(mesh.tetrahedra)), mesh.elements.shape[1])
        shape = (len(mesh.vertices), len(mesh.tetrahedra))
        around = scipy.sparse.csr_matrix((np.ones(len(nodes)), (nodes, tets)), shape=shape)
        neighbours = (around.T @ around).tocsr()
        needed = POINTS_PER_TERM * _terms(np.zeros((1, 3)), mesh.element_order).shape[1]
        rows, columns, weights = [], [], []
        for node, place in enumerate(mesh.vertices):
            patch = around.indices[around.indptr[node] : around.indptr[node + 1]]
            while len(patch) * points < needed and len(patch) < len(mesh.tetrahedra):
                patch = np.unique(neighbours[patch].indices)
            chosen = (points * patch[:, None] + np.arange(points)).ravel()
            offset = places[chosen] - place
            inverse = np.linalg.pinv(_terms(offset / np.abs(offset).max(), mesh.element_order), rcond=1e-6)
            rows.append(np.full(len(chosen), node))
            columns.append(chosen)
            weights.append(inverse[0])
        entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
        return scipy.sparse.csr_matrix(entries, shape=(len(mesh.vertices), len(places)))


def _terms(x: np.ndarray, degree: int) -> np.ndarray:
    """Monomials of a polynomial of degree 1 or 2, constant first, shape ``(point, term)``."""
    linear = [np.ones(len(x)), *x.T]
    if degree == 2:
        linear += [x[:, i] * x[:, j] for i in range(3) for j in range(i, 3)]
    return np.stack(linear, axis=1)
