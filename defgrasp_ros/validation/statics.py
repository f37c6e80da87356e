"""Static equilibrium of a body with clamped nodes and nodal loads.

The product has contacts, no clamps; a beam needs one. The residual is the simulator's own elastic force, so what is
found is its equilibrium. Newton's tangent is the exact derivative of the co-rotational force, written here a second
time and independently: with F = R U and Omega = R^T dR,

    (tr(U) I - U) axial(Omega) = axial(R^T dF - dF^T R),    dP = dR sigma + R (2 mu dS + lambda tr(dS) I).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from defgrasp_ros.errors import SolverDivergedError
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator

WORLD = np.array([0])
ACCURACY = 1e-8
"""Residual force at which an equilibrium counts as found, relative to the forces in it [-]; rounding leaves 1.2e-9 of a
bent beam with 6500 nodes, whose elements carry far larger forces than the load."""
MAX_ITERATIONS = 30
LEVI_CIVITA = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]], [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]]
)


class ClampedBody:
    """A body of which some displacement components are given; keeps its displacement from load to load.

    Args:
        model: The object.
        clamped: Which components are given, shape ``(node, 3)``.
        device: Warp device on which forces are evaluated.
    """

    def __init__(self, model: ObjectModel, clamped: np.ndarray, device: str):
        self.model = model
        self.simulator = Simulator(model, load_gripper(), 1, device)
        self._free = np.flatnonzero(~clamped.ravel())
        self.displacement = np.zeros(model.mesh.vertices.shape)

    def balance(self, load: np.ndarray, given: np.ndarray | None = None) -> np.ndarray:
        """Return the displacement in equilibrium [m], shape ``(node, 3)``.

        Args:
            load: Force on each node [N], shape ``(node, 3)``.
            given: Displacement whose clamped components are taken [m], shape ``(node, 3)``; None: as they are.

        Raises:
            SolverDivergedError: If Newton's method does not find it.
        """
        displacement = self.displacement.copy()
        if given is not None:
            clamped = np.ones(displacement.size, dtype=bool)
            clamped[self._free] = False
            change = np.where(clamped, (given - displacement).ravel(), 0.0)
            tangent = tangent_stiffness(self.model, displacement)
            right_side = -(tangent @ change)[self._free]
            change[self._free] = splu(tangent[self._free][:, self._free].tocsc()).solve(right_side)
            displacement += change.reshape(displacement.shape)
        for _ in range(MAX_ITERATIONS):
            internal = self.elastic_forces(displacement)
            residual = (load + internal).ravel()[self._free]
            if np.linalg.norm(residual) <= ACCURACY * max(np.linalg.norm(internal), np.linalg.norm(load)):
                self.displacement = displacement
                return displacement
            tangent = tangent_stiffness(self.model, displacement)[self._free][:, self._free]
            step = np.zeros(displacement.size)
            step[self._free] = splu(tangent.tocsc()).solve(residual)
            displacement = displacement + step.reshape(displacement.shape)
        raise SolverDivergedError("no static equilibrium; apply the load in smaller steps")

    def elastic_forces(self, displacement: np.ndarray) -> np.ndarray:
        """The simulator's elastic force on each node [N], shape ``(node, 3)``."""
        self.simulator.set_displacement(WORLD, displacement)
        return self.simulator.elastic_forces(WORLD)[0]

    def stresses(self) -> np.ndarray:
        """Stress of each element in its rotated frame [Pa], shape ``(tet, 3, 3)``."""
        self.simulator.set_displacement(WORLD, self.displacement)
        return self.simulator.stresses(WORLD)[0][0]


def tangent_stiffness(model: ObjectModel, displacement: np.ndarray) -> scipy.sparse.csr_matrix:
    """Return -d(elastic force)/d(displacement) [N/m], sparse, shape ``(3 node, 3 node)``."""
    mesh, (lame_lambda, lame_mu) = model.mesh, model.material.lame_parameters
    identity = np.eye(3)
    gradient = identity + np.einsum("tai,taj->tij", displacement[mesh.tetrahedra], mesh.shape_gradients)
    left, _, right = np.linalg.svd(gradient)
    rotation = left @ right
    stretch = np.swapaxes(rotation, 1, 2) @ gradient
    trace = np.trace(stretch, axis1=1, axis2=2)[:, None, None]
    stress = 2.0 * lame_mu * (stretch - identity) + lame_lambda * (trace - 3.0) * identity

    # Directions dF = e_k (x) e_l; A = R^T dF.
    turned = np.einsum("tki,lj->tklij", rotation, identity)
    axial = np.einsum("mij,tklij->tklm", LEVI_CIVITA, turned)
    spin = -np.einsum("tmn,tkln->tklm", np.linalg.inv(trace * identity - stretch), axial)
    spin_matrix = -np.einsum("mij,tklm->tklij", LEVI_CIVITA, spin)
    change = turned - spin_matrix @ stretch[:, None, None]
    change = 0.5 * (change + np.swapaxes(change, -1, -2))
    dilation = np.einsum("tklii->tkl", change)[..., None, None] * identity
    force_change = spin_matrix @ stress[:, None, None] + 2.0 * lame_mu * change + lame_lambda * dilation
    force_change = rotation[:, None, None] @ force_change

    g = mesh.shape_gradients
    blocks = np.einsum("t,tklij,taj,tbl->taibk", mesh.volumes, force_change, g, g, optimize=True)
    index = (3 * mesh.tetrahedra[:, :, None] + np.arange(3)).reshape(-1, 12)
    rows, columns = np.repeat(index, 12, axis=1).ravel(), np.tile(index, (1, 12)).ravel()
    size = 3 * len(mesh.vertices)
    return scipy.sparse.coo_matrix((blocks.ravel(), (rows, columns)), shape=(size, size)).tocsr()
