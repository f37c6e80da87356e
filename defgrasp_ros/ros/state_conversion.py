"""The state of running grasps as joint states and contacts."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from defgrasp_interfaces.msg import ContactState
from sensor_msgs.msg import JointState

from defgrasp_ros.evaluation import FINGER_NAMES, GraspSample
from defgrasp_ros.ros.request_conversion import OBJECT_FRAME
from defgrasp_ros.ros.result_conversion import contact_to_message

JOINT_NAMES = [f"{finger}_joint" for finger in FINGER_NAMES]
"""The two prismatic joints of the gripper, left then right."""


def sample_to_joint_state(sample: GraspSample, stamp: Time) -> JointState:
    """Return the finger joints of one grasp.

    A run simulates many grasps at once, each with a gripper of its own: ``header.frame_id`` is the id of the grasp
    (its index where it has none). Position: distance of the pad face from the middle [m]; velocity [m/s], negative
    when closing; effort: closing force of the finger [N].
    """
    message = JointState(
        name=JOINT_NAMES,
        position=[float(sample.opening)] * 2,
        velocity=[float(sample.opening_velocity)] * 2,
        effort=[0.5 * float(sample.closing_force)] * 2,
    )
    message.header.stamp = stamp
    message.header.frame_id = sample.grasp_id or str(sample.grasp_index)
    return message


def sample_to_contact_state(sample: GraspSample, stamp: Time) -> ContactState:
    """Return what the fingers of one grasp and the platform feel."""
    message = ContactState(
        grasp_id=sample.grasp_id,
        grasp_index=sample.grasp_index,
        fingers=[contact_to_message(contact) for contact in sample.contacts],
        normal_force=sum(contact.normal_force for contact in sample.contacts),
        platform_force=float(sample.platform_force),
    )
    message.header.stamp = stamp
    message.header.frame_id = OBJECT_FRAME
    return message
