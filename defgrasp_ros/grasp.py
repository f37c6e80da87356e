"""Candidate grasps and the grasp frame.

The grasp frame is at the tool centre point, midway between the two pads: **+z approaches** (away from the
palm), **+y is the closing axis** (towards the left finger), right-handed, so x runs across the pad width. This
is the orientation of ``panda_hand`` and the pose of ``panda_hand_tcp``. Poses are given in the object frame O,
the frame of the mesh vertices, z up. Quaternions are x y z w.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidGraspError

QUATERNION_NORM_TOLERANCE = 1e-3
"""How far from 1 the norm of a quaternion may be; within it is normalised, beyond it is refused."""


@dataclass(frozen=True)
class Grasp:
    """One candidate grasp.

    Args:
        position: Tool centre point in the object frame [m], shape ``(3,)``.
        orientation: Quaternion x y z w of the grasp frame in the object frame, unit norm, shape ``(4,)``.
        id: Name that comes back with the result; the caller's own.
        target_force: SUM of the two pad normal forces [N]; None: safety factor x m g / mu.

    Raises:
        InvalidGraspError: If a number is not finite, the quaternion is not a unit quaternion, or the target
            force is not positive.
    """

    position: np.ndarray
    orientation: np.ndarray
    id: str = ""
    target_force: float | None = None
    rotation: np.ndarray = field(init=False, repr=False, compare=False)
    """Rotation matrix of the grasp frame in the object frame; columns: pad width x, closing axis y, approach z."""

    def __post_init__(self) -> None:
        position = np.asarray(self.position, dtype=float)
        orientation = np.asarray(self.orientation, dtype=float)
        label = f"grasp '{self.id}'"
        if position.shape != (3,) or not np.isfinite(position).all():
            raise InvalidGraspError(f"{label}: position = {position.tolist()} must be three finite numbers [m]")
        if orientation.shape != (4,) or not np.isfinite(orientation).all():
            raise InvalidGraspError(
                f"{label}: orientation = {orientation.tolist()} must be four finite numbers, x y z w"
            )
        norm = float(np.linalg.norm(orientation))
        if norm == 0.0:
            raise InvalidGraspError(
                f"{label}: orientation is the zero quaternion; give x y z w with norm 1, identity is 0 0 0 1"
            )
        if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
            raise InvalidGraspError(
                f"{label}: orientation = {orientation.tolist()} has norm {norm:.6g}, not 1; "
                "normalise it (order is x y z w)"
            )
        if self.target_force is not None:
            require_in_range(
                InvalidGraspError, f"{label}: target_force", self.target_force, 0.0, 1e5, low_open=True, unit="N"
            )
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "orientation", orientation / norm)
        object.__setattr__(self, "rotation", Rotation.from_quat(self.orientation).as_matrix())
