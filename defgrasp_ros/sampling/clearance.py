"""Whether an open gripper fits around an object, and has something between its pads."""

from __future__ import annotations

from enum import Enum

import numpy as np

from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.box_overlap import triangles_meeting_box
from defgrasp_ros.mesh.rays import RayCaster

Box = tuple[np.ndarray, np.ndarray]
"""Lower and upper corner in the grasp frame [m], each of shape ``(3,)``."""


class Fit(Enum):
    """How an open gripper stands to the object."""

    FREE = "free"
    FINGER_COLLISION = "a finger is inside the object"
    PALM_COLLISION = "the palm is inside the object"
    EMPTY = "nothing is between the pads"


def finger_boxes(gripper: Gripper, opening: float) -> tuple[Box, Box]:
    """Return the boxes of the left and the right finger behind their pad faces; fillets are not cut off.

    Args:
        gripper: Its pads.
        opening: Distance of each pad face from the grasp frame's origin [m].
    """
    outer = opening + gripper.finger_thickness
    half, bottom, tip = gripper.finger_half_width, gripper.pad_bottom, gripper.tip
    left = np.array([-half, opening, bottom]), np.array([half, outer, tip])
    right = np.array([-half, -outer, bottom]), np.array([half, -opening, tip])
    return left, right


def palm_box(gripper: Gripper) -> Box | None:
    """Return the box of the palm, from the hand's base to its face; None for a gripper without."""
    palm = gripper.palm
    if palm is None:
        return None
    low = np.array([-palm.half_width, -palm.half_length, -gripper.hand_to_tcp])
    return low, np.array([palm.half_width, palm.half_length, palm.face])


def closing_region(gripper: Gripper) -> Box:
    """Return the box between the faces of the open pads."""
    half, reach = gripper.pad_half_width, gripper.max_opening
    return np.array([-half, -reach, gripper.pad_bottom]), np.array([half, reach, gripper.pad_top])


class HandFit:
    """Tests poses of one gripper at one object; the platform is no part of the test.

    Args:
        vertices: Positions in the object frame [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``, of a closed surface.
        gripper: The gripper, fully open.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, gripper: Gripper):
        corners = np.asarray(vertices, dtype=np.float64)[triangles]
        self._corners = corners
        self._low, self._high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        centres = corners.mean(axis=1)
        self._centres = np.ascontiguousarray(centres.T)
        self._radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
        self._largest = float(self._radii.max())
        self._rays = RayCaster(vertices, triangles)
        self._fingers = finger_boxes(gripper, gripper.max_opening)
        self._palm = palm_box(gripper)
        self._closing_region = closing_region(gripper)

    def check(self, position: np.ndarray, rotation: np.ndarray) -> Fit:
        """Return how the open gripper stands at a pose.

        Args:
            position: Origin of the grasp frame in the object frame [m], shape ``(3,)``.
            rotation: Its axes as columns, shape ``(3, 3)``.
        """
        centres = rotation.T @ self._centres - (rotation.T @ position)[:, None]
        if any(self._touches(box, centres, position, rotation) for box in self._fingers):
            return Fit.FINGER_COLLISION
        if self._palm and self._touches(self._palm, centres, position, rotation):
            return Fit.PALM_COLLISION
        if not self._touches(self._closing_region, centres, position, rotation):
            return Fit.EMPTY
        # A box that no triangle meets is outside of the object, or swallowed whole.
        if any(self._swallows(box, position, rotation) for box in self._fingers):
            return Fit.FINGER_COLLISION
        if self._palm and self._swallows(self._palm, position, rotation):
            return Fit.PALM_COLLISION
        return Fit.FREE

    def _swallows(self, box: Box, position: np.ndarray, rotation: np.ndarray) -> bool:
        corners = position + np.stack(box) @ rotation.T
        if ((corners < self._low) | (corners > self._high)).any():
            return False
        return bool(self._rays.contains(corners.mean(axis=0, keepdims=True))[0])

    def _touches(self, box: Box, centres: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> bool:
        low, high = box
        # Almost all triangles are far away or well inside, which their centres show.
        near = np.arange(centres.shape[1])
        for along, first, last in zip(centres, low - self._largest, high + self._largest, strict=True):
            near = near[(along[near] > first) & (along[near] < last)]
        candidates = centres[:, near].T
        gap = candidates - np.clip(candidates, low, high)
        squared_gap = np.einsum("ij,ij->i", gap, gap)
        if (squared_gap == 0.0).any():
            return True
        near = near[squared_gap <= self._radii[near] ** 2]
        return bool(triangles_meeting_box((self._corners[near] - position) @ rotation, low, high).any())
