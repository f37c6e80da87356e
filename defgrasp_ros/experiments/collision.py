"""Whether the open gripper fits around the object before it closes."""

from __future__ import annotations

import numpy as np

from defgrasp_ros.evaluation import FINGER_NAMES
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.tet_mesh import TetMesh

SAMPLES_PER_EDGE = 6
"""Points along each edge of a finger that are looked for inside the object."""


def colliding_finger(
    mesh: TetMesh, positions: np.ndarray, grasp: Grasp, gripper: Gripper, opening: float
) -> str | None:
    """Return the name of a finger that overlaps the object, or None.

    A finger is a box behind its pad face. It overlaps if a node of the object lies in the box or a point of the
    box lies in a tetrahedron.

    Args:
        mesh: Topology of the object.
        positions: Its nodes [m], shape ``(node, 3)``, in the frame of the grasp's pose.
        grasp: Pose of the gripper.
        gripper: Its pads.
        opening: Distance of each pad face from the grasp frame's origin [m].
    """
    local = (positions - grasp.position) @ grasp.rotation
    for name, side in zip(FINGER_NAMES, (1.0, -1.0), strict=True):
        faces = sorted((side * opening, side * (opening + gripper.finger_thickness)))
        low = np.array([-gripper.pad_half_width, faces[0], gripper.pad_bottom])
        high = np.array([gripper.pad_half_width, faces[1], gripper.tip])
        if ((local > low) & (local < high)).all(axis=1).any() or _box_meets_tetrahedra(
            low, high, local, mesh.tetrahedra
        ):
            return name
    return None


def _box_meets_tetrahedra(low: np.ndarray, high: np.ndarray, nodes: np.ndarray, tetrahedra: np.ndarray) -> bool:
    """Whether a point of a regular grid over an axis-aligned box lies inside a tetrahedron."""
    corners = nodes[tetrahedra]
    near = corners[((corners.max(axis=1) > low) & (corners.min(axis=1) < high)).all(axis=1)]
    if not len(near):
        return False
    axes = (np.linspace(a, b, SAMPLES_PER_EDGE) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    edges = np.moveaxis(near[:, 1:] - near[:, :1], 1, 2)
    weights = np.einsum("tij,tpj->tpi", np.linalg.inv(edges), points[None] - near[:, None, 0])
    return bool(((weights > 0.0).all(axis=2) & (weights.sum(axis=2) < 1.0)).any())
