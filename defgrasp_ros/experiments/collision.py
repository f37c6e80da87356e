"""Whether the open gripper fits around the object before it closes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from defgrasp_ros.evaluation import FINGER_NAMES
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.tet_mesh import TetMesh

PALM_NAME = "palm"
SAMPLES_PER_EDGE = 6
"""Points along each edge of a part that are looked for inside the object."""


def colliding_part(mesh: TetMesh, positions: np.ndarray, grasp: Grasp, gripper: Gripper, opening: float) -> str | None:
    """Return the name of a finger or the palm that overlaps the object, or None.

    A finger is a block behind its pad face, with the fillets; the palm reaches back to the hand's base. A part overlaps
    if a node of the object lies in it or one of its points lies in a tetrahedron.

    Args:
        mesh: Topology of the object.
        positions: Its nodes [m], shape ``(node, 3)``, in the frame of the grasp's pose.
        grasp: Pose of the gripper.
        gripper: Its pads and palm.
        opening: Distance of each pad face from the grasp frame's origin [m].
    """
    local = (positions - grasp.position) @ grasp.rotation
    for name, inside, points in _parts(gripper, opening, local):
        if inside.any() or _any_inside(points, local, mesh.tetrahedra):
            return name
    return None


def _parts(gripper: Gripper, opening: float, nodes: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield name, which nodes lie inside, and points of each part, shape ``(point, 3)``, in the grasp frame."""
    x, y, z = nodes.T
    half = gripper.finger_half_width
    grid = _grid((-half, half), (0.0, 1.0), (gripper.pad_bottom, gripper.tip))
    front = gripper.pad_drop(grid[:, 0], grid[:, 2])
    behind = opening + front + grid[:, 1] * (gripper.finger_thickness - front)
    within = (np.abs(x) < half) & (z > gripper.pad_bottom) & (z < gripper.tip)
    for name, side in zip(FINGER_NAMES, (1.0, -1.0), strict=True):
        depth = side * y - opening
        inside = within & (depth > gripper.pad_drop(x, z)) & (depth < gripper.finger_thickness)
        yield name, inside, np.column_stack([grid[:, 0], side * behind, grid[:, 2]])
    palm = gripper.palm
    if palm:
        inside = (np.abs(x) < palm.half_width) & (np.abs(y) < palm.half_length)
        inside &= (z < palm.face) & (z > -gripper.hand_to_tcp)
        across, along = (-palm.half_width, palm.half_width), (-palm.half_length, palm.half_length)
        yield PALM_NAME, inside, _grid(across, along, (-gripper.hand_to_tcp, palm.face))


def _grid(*ranges: tuple[float, float]) -> np.ndarray:
    """Return the points of a regular grid over an axis-aligned box, shape ``(point, 3)``."""
    axes = (np.linspace(low, high, SAMPLES_PER_EDGE) for low, high in ranges)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _any_inside(points: np.ndarray, nodes: np.ndarray, tetrahedra: np.ndarray) -> bool:
    """Whether a point lies inside a tetrahedron."""
    corners = nodes[tetrahedra]
    low, high = points.min(axis=0), points.max(axis=0)
    near = corners[((corners.max(axis=1) > low) & (corners.min(axis=1) < high)).all(axis=1)]
    if not len(near):
        return False
    edges = np.moveaxis(near[:, 1:] - near[:, :1], 1, 2)
    weights = np.einsum("tij,tpj->tpi", np.linalg.inv(edges), points[None] - near[:, None, 0])
    return bool(((weights > 0.0).all(axis=2) & (weights.sum(axis=2) < 1.0)).any())
