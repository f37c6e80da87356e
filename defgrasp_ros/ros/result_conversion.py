"""Results: the evaluations of grasps as messages (the evaluator's side) and back (the client's side)."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from defgrasp_interfaces import msg

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import (
    DeformedState,
    FingerContact,
    GraspEvaluation,
    GraspFeatures,
    GraspMetrics,
    SolverReport,
)
from defgrasp_ros.ros.fields import extract, fill, flat, point_message, rows, vector_message
from defgrasp_ros.ros.request_conversion import OBJECT_FRAME

NUMBERS = ("target_force", "applied_force", "slip_distance", "holding_time", "simulated_time", "wall_time")
"""Fields of an evaluation that are plain numbers."""


def evaluation_to_message(evaluation: GraspEvaluation, stamp: Time, *, with_fields: bool = True) -> msg.GraspEvaluation:
    """Return the message of an evaluation.

    Args:
        evaluation: Result of one grasp.
        stamp: Start of the run plus simulated time.
        with_fields: Whether to copy the fields over the mesh, too.
    """
    message = msg.GraspEvaluation(
        grasp_id=evaluation.grasp_id,
        grasp_index=evaluation.grasp_index,
        result=msg.Result(code=evaluation.code, message=evaluation.message),
        features=fill(msg.GraspFeatures(), evaluation.features),
        metrics=fill(msg.GraspMetrics(), evaluation.metrics),
        contacts=[contact_to_message(contact) for contact in evaluation.contacts or ()],
        solver=fill(msg.SolverReport(), evaluation.solver),
        fields=[_field_to_message(*item) for item in evaluation.fields.items()] if with_fields else [],
        **{name: float(getattr(evaluation, name)) for name in NUMBERS},
    )
    message.header.stamp = stamp
    message.header.frame_id = OBJECT_FRAME
    return message


def evaluation_from_message(message: msg.GraspEvaluation) -> GraspEvaluation:
    """Return the evaluation of a message."""
    contacts = tuple(contact_from_message(contact) for contact in message.contacts)
    return GraspEvaluation(
        grasp_index=message.grasp_index,
        grasp_id=message.grasp_id,
        code=ResultCode(message.result.code),
        message=message.result.message,
        features=extract(GraspFeatures, message.features),
        metrics=extract(GraspMetrics, message.metrics),
        contacts=contacts or None,
        solver=extract(SolverReport, message.solver),
        fields={field.stage: _field_from_message(field) for field in message.fields},
        **{name: getattr(message, name) for name in NUMBERS},
    )


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


def _field_to_message(stage: str, state: DeformedState) -> msg.ObjectField:
    return msg.ObjectField(
        stage=stage,
        positions=flat(state.positions, "f"),
        von_mises_stress=flat(state.von_mises_stress, "f"),
        opening=float(state.opening),
    )


def _field_from_message(message: msg.ObjectField) -> DeformedState:
    return DeformedState(
        positions=rows(message.positions, 3),
        von_mises_stress=np.asarray(message.von_mises_stress),
        opening=message.opening,
    )
