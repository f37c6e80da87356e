"""What fingers and palm exert on the object, as force and moment about a point."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3, WrenchStamped

from defgrasp_ros.evaluation import FingerContact, GraspSample
from defgrasp_ros.ros.fields import vector_message


def force_and_moment(contacts: Iterable[FingerContact], point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum of contact forces on the object [N] and their moment about a point [N m], shape ``(3,)`` each.

    Args:
        contacts: What touches the object.
        point: In the frame of the contacts [m], shape ``(3,)``.
    """
    force, moment = np.zeros(3), np.zeros(3)
    for contact in contacts:
        force += contact.forces.sum(axis=0)
        moment += np.cross(contact.positions - point, contact.forces).sum(axis=0)
    return force, moment


def sample_to_wrenches(sample: GraspSample, stamp: Time) -> list[WrenchStamped]:
    """Return what the left and the right finger exert on the object, about the middle of the pad face.

    ``header.frame_id`` is the finger's link in the URDF: origin in the middle of the pad face at the height of the
    grasp frame, axes of the grasp frame. The sign is that of ``~/contacts``: force of the finger on the object.
    """
    rotation, messages = sample.grasp.rotation, []
    for contact, side in zip(sample.contacts, (1.0, -1.0), strict=True):
        centre = sample.grasp.position + side * sample.opening * rotation[:, 1]
        force, moment = force_and_moment([contact], centre)
        message = WrenchStamped()
        message.header.stamp = stamp
        message.header.frame_id = contact.name
        message.wrench.force = _local(force, rotation)
        message.wrench.torque = _local(moment, rotation)
        messages.append(message)
    return messages


def _local(vector: np.ndarray, rotation: np.ndarray) -> Vector3:
    return vector_message(rotation.T @ vector)
