"""Grasps for MoveIt, with a stand-in for its messages of the same fields."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import InvalidGraspError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper

pytest.importorskip("rclpy")
geometry = pytest.importorskip("geometry_msgs.msg")
trajectory = pytest.importorskip("trajectory_msgs.msg")

from defgrasp_ros.ros.moveit_conversion import (  # noqa: E402
    PANDA_HAND,
    PANDA_LINK8,
    HandLink,
    grasp_from_moveit,
    grasp_to_moveit,
)

HAND = load_gripper("franka_hand")
TILTED = Grasp(
    np.array([0.01, -0.02, 0.03]),
    Rotation.from_euler("ZXY", [25.0, 170.0, 10.0], degrees=True).as_quat(),
    id="tilted",
    target_force=5.0,
)


@dataclass
class GripperTranslation:
    """moveit_msgs/GripperTranslation."""

    direction: geometry.Vector3Stamped = field(default_factory=geometry.Vector3Stamped)
    desired_distance: float = 0.0
    min_distance: float = 0.0


@dataclass
class MoveItGrasp:
    """moveit_msgs/Grasp."""

    id: str = ""
    pre_grasp_posture: trajectory.JointTrajectory = field(default_factory=trajectory.JointTrajectory)
    grasp_posture: trajectory.JointTrajectory = field(default_factory=trajectory.JointTrajectory)
    grasp_pose: geometry.PoseStamped = field(default_factory=geometry.PoseStamped)
    grasp_quality: float = 0.0
    pre_grasp_approach: GripperTranslation = field(default_factory=GripperTranslation)
    post_grasp_retreat: GripperTranslation = field(default_factory=GripperTranslation)
    post_place_retreat: GripperTranslation = field(default_factory=GripperTranslation)
    max_contact_force: float = 0.0
    allowed_touch_objects: list[str] = field(default_factory=list)


@pytest.fixture
def moveit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package moveit_msgs."""
    package, messages = ModuleType("moveit_msgs"), ModuleType("moveit_msgs.msg")
    messages.Grasp, messages.GripperTranslation = MoveItGrasp, GripperTranslation
    package.msg = messages
    monkeypatch.setitem(sys.modules, "moveit_msgs", package)
    monkeypatch.setitem(sys.modules, "moveit_msgs.msg", messages)


@pytest.mark.parametrize("link", [PANDA_HAND, PANDA_LINK8], ids=lambda link: link.name)
def test_grasp_survives_the_way_there_and_back(moveit: None, link: HandLink) -> None:
    """Position, orientation, force and name are the same after both conversions, for every link."""
    message = grasp_to_moveit(TILTED, HAND, "banana", link=link, quality=0.7)
    back = grasp_from_moveit(message, HAND, link=link)
    np.testing.assert_allclose(back.position, TILTED.position, atol=1e-12)
    np.testing.assert_allclose(back.rotation, TILTED.rotation, atol=1e-12)
    assert (back.id, back.target_force) == ("tilted", 5.0)
    assert (message.grasp_pose.header.frame_id, message.grasp_quality) == ("banana", 0.7)


def test_hand_is_behind_the_object_that_it_grasps_from_above(moveit: None) -> None:
    """From above, the hand's base is 0.1034 m higher than the point between the pads, and turned over."""
    above = Grasp(np.array([0.1, 0.2, 0.3]), np.array([1.0, 0.0, 0.0, 0.0]))
    message = grasp_to_moveit(above, HAND, "object")
    position, orientation = message.grasp_pose.pose.position, message.grasp_pose.pose.orientation
    assert (position.x, position.y, position.z) == pytest.approx((0.1, 0.2, 0.4034))
    assert abs(orientation.x) == pytest.approx(1.0)
    assert message.max_contact_force == 0.0
    assert grasp_from_moveit(message, HAND).target_force is None


def test_flange_is_turned_against_the_hand(moveit: None) -> None:
    """With the flange as link, the closing axis is at 45 degrees to its y, as on the Franka arm."""
    message = grasp_to_moveit(Grasp(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])), HAND, "object", link=PANDA_LINK8)
    orientation = message.grasp_pose.pose.orientation
    flange = Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w])
    assert flange.inv().apply([0.0, 1.0, 0.0]) == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0])


def test_fingers_open_close_and_come_along_the_approach(moveit: None) -> None:
    """Each finger gets half of the force; the gripper comes along z of the hand and goes up."""
    message = grasp_to_moveit(TILTED, HAND, "banana")
    before, after = message.pre_grasp_posture, message.grasp_posture
    assert list(before.joint_names) == ["panda_finger_joint1", "panda_finger_joint2"]
    assert list(before.points[0].positions) == [0.04, 0.04] and list(after.points[0].positions) == [0.0, 0.0]
    assert list(after.points[0].effort) == [2.5, 2.5] and message.max_contact_force == 2.5
    approach, retreat = message.pre_grasp_approach, message.post_grasp_retreat
    assert (approach.direction.header.frame_id, approach.direction.vector.z) == ("panda_hand", 1.0)
    assert (retreat.direction.header.frame_id, retreat.direction.vector.z) == ("world", 1.0)
    assert 0.0 < approach.min_distance < approach.desired_distance


def test_message_without_meaning_is_refused() -> None:
    """A zero quaternion is no orientation."""
    message = MoveItGrasp(id="lost")
    message.grasp_pose.pose.orientation.w = 0.0
    with pytest.raises(InvalidGraspError, match="'lost'.*zero quaternion"):
        grasp_from_moveit(message, HAND)


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without moveit_msgs the error says what to install."""
    monkeypatch.setitem(sys.modules, "moveit_msgs", None)
    with pytest.raises(ImportError, match="ros-jazzy-moveit-msgs"):
        grasp_to_moveit(TILTED, HAND, "banana")
