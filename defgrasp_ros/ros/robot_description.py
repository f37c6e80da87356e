"""The gripper for viewers: its URDF on a topic."""

from __future__ import annotations

from std_msgs.msg import String

from defgrasp_ros.gripper import Gripper
from defgrasp_ros.gripper_urdf import gripper_urdf
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.topics import ROBOT_DESCRIPTION


def send_robot_description(outputs: Outputs, gripper: Gripper, time: int) -> None:
    """Publish and log the URDF of a gripper, as of a time [ns]."""
    outputs.send(ROBOT_DESCRIPTION, String(data=gripper_urdf(gripper)), time)
