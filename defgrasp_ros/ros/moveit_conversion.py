"""Grasps as ``moveit_msgs/Grasp`` and back; needs the package ``moveit_msgs``, which is not among the dependencies.

Two frames differ. A grasp here is the pose of the tool centre point, between the pads, in the object frame. MoveIt's
``grasp_pose`` is the pose of the link that the end effector is attached to, in any frame that MoveIt knows, for
instance that of the collision object, whose name then is its ``frame_id``. Along the approach the tool centre point is
``hand_to_tcp`` of the gripper's description in front of the hand (0.1034 m for ``panda_hand``, whose axes are those of
the grasp frame); how the hand is turned on its link is in ``HandLink``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Pose, Vector3
from scipy.spatial.transform import Rotation
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper


@dataclass(frozen=True)
class HandLink:
    """What MoveIt calls the parts of a gripper.

    Args:
        name: Link that ``grasp_pose`` is about.
        turn: Orientation of the hand on that link, quaternion x y z w.
        finger_joints: Joints that move the fingers.
        open_position: Of each finger joint when the gripper is open [m].
        closed_position: Of each finger joint that a closing gripper is sent to [m].
    """

    name: str = "panda_hand"
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    finger_joints: Sequence[str] = ("panda_finger_joint1", "panda_finger_joint2")
    open_position: float = 0.04
    closed_position: float = 0.0

    def to_grasp_frame(self, gripper: Gripper) -> np.ndarray:
        """Return the pose of the grasp frame on the link, shape ``(4, 4)`` [m]."""
        hand = Rotation.from_quat(self.turn).as_matrix()
        return _pose(hand, hand @ [0.0, 0.0, gripper.hand_to_tcp])


PANDA_HAND = HandLink()
"""The Franka hand, with ``grasp_pose`` the pose of ``panda_hand``."""

PANDA_LINK8 = HandLink("panda_link8", tuple(Rotation.from_euler("z", -45.0, degrees=True).as_quat().tolist()))
"""The same, with ``grasp_pose`` the pose of the flange, on which the hand is turned by -45 degrees."""


@dataclass(frozen=True)
class Translations:
    """How the gripper comes and goes.

    Args:
        approach: Way along the approach before the grasp, wanted and least [m].
        retreat: Way up afterwards, wanted and least [m].
        up_frame: Frame whose z is up.
    """

    approach: tuple[float, float] = (0.1, 0.05)
    retreat: tuple[float, float] = (0.1, 0.05)
    up_frame: str = "world"


def grasp_to_moveit(
    grasp: Grasp,
    gripper: Gripper,
    frame: str,
    *,
    link: HandLink = PANDA_HAND,
    quality: float = 0.0,
    translations: Translations = Translations(),  # noqa: B008 - frozen
) -> Any:
    """Return a ``moveit_msgs/Grasp``.

    Args:
        grasp: In the object frame.
        gripper: With which it was evaluated.
        frame: Name that MoveIt has for the object frame.
        link: What MoveIt calls the parts of the gripper.
        quality: Larger is better, e.g. 1 / peak stress; MoveIt tries good ones first.
        translations: How the gripper comes and goes.

    Raises:
        ImportError: If ``moveit_msgs`` is not installed.
    """
    messages = _moveit_messages()
    message = messages.Grasp(id=grasp.id, grasp_quality=float(quality))
    message.grasp_pose.header.frame_id = frame
    pose = _pose(grasp.rotation, grasp.position) @ np.linalg.inv(link.to_grasp_frame(gripper))
    message.grasp_pose.pose = _pose_message(pose)
    force = grasp.target_force or 0.0
    # What one finger presses with; target_force is the sum of both.
    message.max_contact_force = 0.5 * force
    message.pre_grasp_posture = _posture(link, link.open_position)
    message.grasp_posture = _posture(link, link.closed_position, 0.5 * force)
    approach = Rotation.from_quat(link.turn).apply([0.0, 0.0, 1.0])
    _translate(message.pre_grasp_approach, link.name, approach, translations.approach)
    _translate(message.post_grasp_retreat, translations.up_frame, [0.0, 0.0, 1.0], translations.retreat)
    return message


def grasp_from_moveit(message: Any, gripper: Gripper, *, link: HandLink = PANDA_HAND) -> Grasp:
    """Return the grasp of a ``moveit_msgs/Grasp`` whose ``grasp_pose`` is given in the object's frame.

    ``max_contact_force`` is what one finger presses with; where it is not positive, the evaluator chooses the force.

    Raises:
        InvalidGraspError: If a number has no meaning.
    """
    position, orientation = message.grasp_pose.pose.position, message.grasp_pose.pose.orientation
    quaternion = [orientation.x, orientation.y, orientation.z, orientation.w]
    # Checked as a grasp, so that a zero quaternion is refused with the usual words.
    hand = Grasp(np.array([position.x, position.y, position.z]), np.array(quaternion), id=message.id)
    pose = _pose(hand.rotation, hand.position) @ link.to_grasp_frame(gripper)
    force = 2.0 * message.max_contact_force
    return Grasp(
        position=pose[:3, 3],
        orientation=Rotation.from_matrix(pose[:3, :3]).as_quat(),
        id=message.id,
        target_force=force if force > 0.0 else None,
    )


def _moveit_messages() -> Any:
    try:
        import moveit_msgs.msg
    except ImportError:
        raise ImportError(
            "grasps for MoveIt need the package moveit_msgs; install it, e.g. 'apt install ros-jazzy-moveit-msgs', "
            "and source the installation"
        ) from None
    return moveit_msgs.msg


def _pose(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def _pose_message(pose: np.ndarray) -> Pose:
    message = Pose()
    p, q = message.position, message.orientation
    p.x, p.y, p.z = map(float, pose[:3, 3])
    q.x, q.y, q.z, q.w = map(float, Rotation.from_matrix(pose[:3, :3]).as_quat())
    return message


def _posture(link: HandLink, position: float, effort: float = 0.0) -> JointTrajectory:
    """Return one point of the finger joints; ``effort`` is of each [N]."""
    count = len(link.finger_joints)
    point = JointTrajectoryPoint(positions=[position] * count, time_from_start=Duration(sec=1))
    if effort:
        point.effort = [effort] * count
    return JointTrajectory(joint_names=list(link.finger_joints), points=[point])


def _translate(message: Any, frame: str, direction: Sequence[float], way: tuple[float, float]) -> None:
    """Fill in a ``moveit_msgs/GripperTranslation``."""
    x, y, z = map(float, direction)
    message.direction.header.frame_id = frame
    message.direction.vector = Vector3(x=x, y=y, z=z)
    message.desired_distance, message.min_distance = way
