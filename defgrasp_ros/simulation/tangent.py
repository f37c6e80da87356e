"""The inverse of one deformed body, for steps whose iteration the shared inverse does not bring to an end.

    A(u, h) = M / h^2 + K(u)

K is the Hessian of the elastic energy at u, made positive semi-definite. At a point with F = R U, U with the principal
stretches s_i, and the modes r = R and q_k = U_svd (e_i e_j^T - e_j e_i^T) V_svd^T / sqrt(2) it is

    d2 psi / dF2 = 2 mu + lambda r r^T + sum_k (t_k - 2 mu) q_k q_k^T,
    t_k = 2 mu + 2 (lambda (s_1 + s_2 + s_3 - 3) - 2 mu) / (s_i + s_j)

(Smith, de Goes and Kim 2019). The t_k, which vanish at rest, stiffen a body under tension against bending, as in a
taut string; the inverse at rest knows nothing of that. Those below zero, under compression, are left out.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.rest_system import assemble_stiffness

LEAST_STRETCH = 0.1
"""Sum of two stretches below which twisting them is not stiffened further [-]; it grows without bounds towards 0."""


def tangent_stiffness(model: ObjectModel, displacement: np.ndarray) -> scipy.sparse.csr_matrix:
    """Assemble K(u) [N/m].

    Args:
        model: Mesh and material.
        displacement: Of the nodes [m], shape ``(node, 3)``.

    Returns:
        Symmetric and positive semi-definite, shape ``(3 node, 3 node)``.
    """
    mesh = model.mesh
    gradients = REFERENCE_ELEMENTS[mesh.element_order].gradients(mesh.shape_gradients)
    moved = displacement[mesh.elements]
    blocks = np.zeros((len(mesh.tetrahedra), 3 * mesh.elements.shape[1], 3 * mesh.elements.shape[1]))
    for g in np.moveaxis(gradients, 1, 0):
        deformation = np.eye(3) + np.einsum("tai,taj->tij", moved, g)
        energy = point_hessian(deformation, *model.material.lame_parameters)
        blocks += np.einsum("tbj,tijkl,tdl->tbidk", g, energy, g, optimize=True).reshape(blocks.shape)
    return assemble_stiffness(mesh, blocks)


def point_hessian(deformation: np.ndarray, lame_lambda: float, lame_mu: float) -> np.ndarray:
    """Return d2 psi / dF2 without its negative part [Pa], shape ``(n, 3, 3, 3, 3)``, for F of shape ``(n, 3, 3)``."""
    left, stretch, right = np.linalg.svd(deformation)
    flip = np.where(np.linalg.det(left) * np.linalg.det(right) < 0.0, -1.0, 1.0)
    left[:, :, 2] *= flip[:, None]
    stretch[:, 2] *= flip
    rotation = left @ right
    hessian = lame_lambda * np.einsum("tij,tkl->tijkl", rotation, rotation)
    hessian += 2.0 * lame_mu * np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
    pressure = lame_lambda * (stretch.sum(axis=1) - 3.0) - 2.0 * lame_mu
    for i, j in ((0, 1), (0, 2), (1, 2)):
        pair = np.maximum(stretch[:, i] + stretch[:, j], LEAST_STRETCH)
        twist = np.maximum(2.0 * lame_mu + 2.0 * pressure / pair, 0.0)
        mode = (np.einsum("ti,tj->tij", left[:, :, i], right[:, j]) - np.einsum("ti,tj->tij", left[:, :, j], right[:, i]))
        mode /= np.sqrt(2.0)
        hessian += np.einsum("t,tij,tkl->tijkl", twist - 2.0 * lame_mu, mode, mode)
    return hessian
