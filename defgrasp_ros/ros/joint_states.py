"""The hand of a grasp as joint states: fingers and the virtual wrist of the gripper's URDF."""

from __future__ import annotations

import array
import math

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from defgrasp_ros.evaluation import GraspSample
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.gripper_urdf import FINGER_JOINTS, WRIST_AXES
from defgrasp_ros.ros.wrenches import force_and_moment

JOINT_NAMES = (*FINGER_JOINTS, *WRIST_AXES)
GIMBAL_LOCK = 1e-9
"""Cosine of the pitch below which roll and yaw turn about the same axis, and the yaw is taken to be 0 [-]."""


def sample_to_joint_state(sample: GraspSample, gripper: Gripper, stamp: Time) -> JointState:
    """Return the joints of one grasp's hand; with ``~/robot_description`` they show the hand where it is.

    Positions are those of the URDF: distance of the pad face from the middle [m], and the pose of ``gripper_base`` in
    ``world`` [m, rad]. Efforts act along the joints' axes: of a finger, what the drive exerts on it, negative when
    closing [N]; of the wrist, what it exerts on a hand without weight so that it stays where it is, which is the
    load that fingers and palm put on the object [N, N m]. The hand stands still; experiments that move it are
    simulated in its own frame. ``header.frame_id`` is the id of the grasp (its index where it has none).
    """
    finger_effort = -0.5 * sample.closing_force
    message = JointState(
        name=JOINT_NAMES,
        position=array.array("d", [sample.opening] * 2 + wrist_positions(sample.grasp, gripper.hand_to_tcp)),
        velocity=array.array("d", [sample.opening_velocity] * 2 + [0.0] * len(WRIST_AXES)),
        effort=array.array("d", [finger_effort] * 2 + _wrist_efforts(sample, gripper.hand_to_tcp)),
    )
    message.header.stamp = stamp
    message.header.frame_id = sample.grasp_id or str(sample.grasp_index)
    return message


def wrist_positions(grasp: Grasp, hand_to_tcp: float) -> list[float]:
    """Return x, y, z [m], yaw, pitch and roll [rad] of the wrist that holds the hand at a grasp pose.

    Args:
        grasp: Pose of the tool centre point.
        hand_to_tcp: Distance from the hand's base to it [m].
    """
    rotation = grasp.rotation
    cosine = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], cosine)
    if cosine > GIMBAL_LOCK:
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
        roll = math.atan2(rotation[2, 1], rotation[2, 2])
    else:
        yaw, roll = 0.0, math.atan2(-rotation[1, 2], rotation[1, 1])
    return [*_base(grasp, hand_to_tcp).tolist(), yaw, pitch, roll]


def _base(grasp: Grasp, hand_to_tcp: float) -> np.ndarray:
    """Return where the hand's base is [m], shape ``(3,)``."""
    return grasp.position - hand_to_tcp * grasp.rotation[:, 2]


def _wrist_efforts(sample: GraspSample, hand_to_tcp: float) -> list[float]:
    """Return the forces [N] and moments [N m] along the axes of the wrist's joints, which meet in the hand's base."""
    force, moment = force_and_moment((*sample.contacts, sample.palm), _base(sample.grasp, hand_to_tcp))
    yaw = wrist_positions(sample.grasp, hand_to_tcp)[3]
    axes = np.array([[0.0, 0.0, 1.0], [-math.sin(yaw), math.cos(yaw), 0.0], sample.grasp.rotation[:, 0]])
    return [*force.tolist(), *(axes @ moment).tolist()]
