"""Performance metrics as functions of states: stress, deformation and strain energy.

Definitions after DefGraspSim (Huang et al., RA-L 2022); nothing here simulates.
"""

from __future__ import annotations

import numpy as np


def von_mises_stress(stress: np.ndarray) -> np.ndarray:
    """Return the von Mises stress sqrt(3/2 s : s), s the deviator; it does not depend on the frame.

    Args:
        stress: Symmetric stress tensors [Pa], shape ``(..., 3, 3)``.

    Returns:
        Von Mises stress [Pa], shape ``(...)``, never negative.
    """
    mean = np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3.0
    deviator = stress - mean * np.eye(3)
    return np.sqrt(1.5 * np.einsum("...ij,...ij->...", deviator, deviator))


def rigid_motion(source: np.ndarray, target: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation and translation that bring ``source`` closest to ``target`` (Kabsch 1976).

    Args:
        source: Points [m], shape ``(node, 3)``.
        target: The same points elsewhere [m], shape ``(node, 3)``.
        weights: Weight of each point [-], shape ``(node,)``; nodal volumes make the fit independent of the mesh.

    Returns:
        Rotation matrix R, shape ``(3, 3)``, and translation t [m], shape ``(3,)``, of target ~ R source + t.
    """
    share = weights / weights.sum()
    source_mean, target_mean = share @ source, share @ target
    covariance = (source - source_mean).T @ (share[:, None] * (target - target_mean))
    u, _, vt = np.linalg.svd(covariance)
    sign = np.sign(np.linalg.det(vt.T @ u.T))
    rotation = vt.T @ np.diag([1.0, 1.0, sign]) @ u.T
    return rotation, target_mean - rotation @ source_mean


def deformation(reference: np.ndarray, deformed: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return how far each node moved once the best rigid motion is taken away [m], shape ``(node,)``.

    Args:
        reference: Nodes before [m], shape ``(node, 3)``.
        deformed: Nodes after [m], shape ``(node, 3)``.
        weights: Nodal volumes [m^3], shape ``(node,)``.
    """
    rotation, translation = rigid_motion(reference, deformed, weights)
    return np.linalg.norm((deformed - translation) @ rotation - reference, axis=1)


def centre_of_mass(positions: np.ndarray, node_volumes: np.ndarray) -> np.ndarray:
    """Return the centre of mass of a deformed object [m], shape ``(3,)``; mass stays with its node.

    Args:
        positions: Nodes [m], shape ``(node, 3)``.
        node_volumes: Share of each node in the volume at rest [m^3], shape ``(node,)``.
    """
    return node_volumes @ positions / node_volumes.sum()
