"""States as messages: what the fingers of a running grasp feel, and fields over the mesh."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from defgrasp_interfaces import msg

from defgrasp_ros.evaluation import DeformedState, FingerContact, GraspSample
from defgrasp_ros.ros.fields import flat, point_message, rows, vector_message
from defgrasp_ros.ros.request_conversion import OBJECT_FRAME


def contact_to_message(contact: FingerContact) -> msg.FingerContact:
    """Return the message of what one finger feels."""
    return msg.FingerContact(
        name=contact.name,
        count=contact.count,
        positions=flat(contact.positions),
        normals=flat(contact.normals),
        forces=flat(contact.forces),
        slipping=bool(contact.slipping),
        normal_force=contact.normal_force,
        tangential_force=vector_message(contact.tangential_force),
        centroid=point_message(contact.centroid),
    )


def contact_from_message(message: msg.FingerContact) -> FingerContact:
    """Return what one finger feels; sums are made anew from the contact points."""
    return FingerContact(
        name=message.name,
        positions=rows(message.positions, 3),
        normals=rows(message.normals, 3),
        forces=rows(message.forces, 3),
        slipping=message.slipping,
    )


def field_to_message(stage: str, state: DeformedState) -> msg.ObjectField:
    """Return the message of shape and stress, in single precision."""
    return msg.ObjectField(
        stage=stage,
        positions=flat(state.positions, "f"),
        von_mises_stress=flat(state.von_mises_stress, "f"),
        opening=float(state.opening),
    )


def field_from_message(message: msg.ObjectField) -> DeformedState:
    """Return shape and stress of a message."""
    return DeformedState(
        positions=rows(message.positions, 3).astype(np.float32, copy=False),
        von_mises_stress=np.asarray(message.von_mises_stress, dtype=np.float32),
        opening=message.opening,
    )


def sample_to_contact_state(sample: GraspSample, stamp: Time) -> msg.ContactState:
    """Return what fingers and palm of one grasp and the platform feel."""
    message = msg.ContactState(
        grasp_id=sample.grasp_id,
        grasp_index=sample.grasp_index,
        fingers=[contact_to_message(contact) for contact in sample.contacts],
        normal_force=sum(contact.normal_force for contact in sample.contacts),
        platform_force=float(sample.platform_force),
        palm_force=vector_message(sample.palm_force),
    )
    message.header.stamp = stamp
    message.header.frame_id = OBJECT_FRAME
    return message
