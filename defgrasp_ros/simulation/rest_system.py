"""The rest state's mass, stiffness and the inverse that all worlds share.

    A0(h) = M / h^2 + K0,      P(h) = A0(h)^-1

K0 is the stiffness of the undeformed mesh, M its mass (diagonal at element order 1). P depends on the object and the
step length only, so one dense matrix serves every grasp of a batch. It sets how fast the iteration of a step converges,
never what it converges to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse

from defgrasp_ros.errors import InvalidMeshError
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.lapack import inverse_of_positive_definite
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS


@dataclass(frozen=True, eq=False)
class Compliance:
    """The inverse for one step length."""

    step_length: float
    """h [s]."""
    matrix: np.ndarray
    """P [m/N], shape ``(3 node, 3 node)``, symmetric."""
    elastic: np.ndarray
    """Mean diagonal of P less its rigid-body part, per node [m/N], shape ``(node,)``: the local flexibility."""
    rigid: float
    """h^2 / m [m/N]: how far a unit force moves the free body as a whole in one step."""


class RestSystem:
    """Mass and rest stiffness of an object, and their combined inverse for any step length."""

    def __init__(self, model: ObjectModel):
        self.mass = mass_matrix(model)
        """M [kg], sparse, shape ``(node, node)``; the same along x, y and z."""
        self.stiffness = rest_stiffness(model)
        """K0 [N/m], sparse, shape ``(3 node, 3 node)``."""
        self._rigid_modes = rigid_modes(model.mesh.vertices, self.mass)

    def compliance(self, step_length: float) -> Compliance:
        """Return P(h).

        Raises:
            InvalidMeshError: If the stiffness is not positive semi-definite, as with inverted elements.
        """
        matrix = self.stiffness.toarray()
        mass = self.mass.toarray() / step_length**2
        for axis in range(3):
            matrix[axis::3, axis::3] += mass
        inverse = inverse_of_positive_definite(matrix)
        if inverse is None:
            raise InvalidMeshError(
                "the mesh has no positive definite stiffness: it contains degenerate or inverted tetrahedra"
            )
        rigid_diagonal = step_length**2 * (self._rigid_modes**2).sum(axis=1)
        elastic = (np.diagonal(inverse) - rigid_diagonal).reshape(-1, 3).mean(axis=1)
        return Compliance(step_length, inverse, elastic, step_length**2 / self.mass.sum())


def mass_matrix(model: ObjectModel) -> scipy.sparse.csr_matrix:
    """Assemble M [kg], shape ``(node, node)``."""
    mesh = model.mesh
    element = REFERENCE_ELEMENTS[mesh.element_order].mass
    masses = model.material.density * mesh.volumes
    first, second = np.nonzero(element)
    entries = masses[:, None] * element[first, second]
    shape = (len(mesh.vertices),) * 2
    rows, columns = mesh.elements[:, first].ravel(), mesh.elements[:, second].ravel()
    return scipy.sparse.coo_matrix((entries.ravel(), (rows, columns)), shape=shape).tocsr()


def rest_stiffness(model: ObjectModel) -> scipy.sparse.csr_matrix:
    """Assemble K0, K_ab = sum over points of V_q (lambda G_a G_b^T + mu G_b G_a^T + mu (G_a . G_b) I) [N/m].

    G_a is the gradient of shape function a at the point. The quadrature is exact.
    """
    mesh = model.mesh
    reference = REFERENCE_ELEMENTS[mesh.element_order]
    lame_lambda, lame_mu = model.material.lame_parameters
    size = 3 * reference.node_count
    blocks = np.zeros((len(mesh.tetrahedra), size, size))
    for g in np.moveaxis(reference.gradients(mesh.shape_gradients), 1, 0):
        product = np.einsum("tai,tbj->taibj", g, g)
        point = lame_lambda * product + lame_mu * product.transpose(0, 1, 4, 3, 2)
        point += lame_mu * np.einsum("taibi,jk->tajbk", product, np.eye(3))
        blocks += point.reshape(blocks.shape)
    blocks *= (mesh.volumes / reference.point_count)[:, None, None]
    index = (3 * mesh.elements[:, :, None] + np.arange(3)).reshape(-1, size)
    rows = np.repeat(index, size, axis=1).ravel()
    columns = np.tile(index, (1, size)).ravel()
    shape = (3 * len(mesh.vertices),) * 2
    return scipy.sparse.coo_matrix((blocks.ravel(), (rows, columns)), shape=shape).tocsr()


def rigid_modes(vertices: np.ndarray, mass: scipy.sparse.csr_matrix) -> np.ndarray:
    """Return the six rigid-body modes Phi with Phi^T M Phi = I, shape ``(3 node, 6)``."""
    weights = mass @ np.ones(len(vertices))
    centred = vertices - weights @ vertices / weights.sum()
    translations = np.tile(np.eye(3), (len(vertices), 1, 1))
    rotations = np.cross(np.eye(3)[None, :, :], centred[:, None, :]).transpose(0, 2, 1)
    modes = np.concatenate([translations, rotations], axis=2)
    inertia = np.einsum("nij,nik->jk", modes, np.einsum("nm,mik->nik", mass.toarray(), modes))
    flat = modes.reshape(-1, 6)
    return scipy.linalg.solve_triangular(np.linalg.cholesky(inertia), flat.T, lower=True).T
