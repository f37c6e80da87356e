"""Results: the evaluations of grasps as messages (the evaluator's side) and back (the client's side)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from builtin_interfaces.msg import Time
from defgrasp_interfaces import msg

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import (
    GraspEvaluation,
    GraspFeatures,
    GraspMetrics,
    SolverReport,
)
from defgrasp_ros.ros.experiment_conversion import (
    acceleration_from_message,
    acceleration_to_message,
    pickup_from_message,
    pickup_to_message,
    reorientation_from_message,
    reorientation_to_message,
    squeeze_from_message,
    squeeze_to_message,
)
from defgrasp_ros.ros.fields import extract, fill, vector_from_message, vector_message
from defgrasp_ros.ros.request_conversion import OBJECT_FRAME
from defgrasp_ros.ros.state_conversion import (
    contact_from_message,
    contact_to_message,
    field_from_message,
    field_to_message,
)

Source = TypeVar("Source")
Target = TypeVar("Target")

NUMBERS = (
    "target_force",
    "applied_force",
    "slip_distance",
    "holding_time",
    "loss_of_contact_time",
    "simulated_time",
    "wall_time",
    "stress_error",
    "deformation_error",
)
"""Fields of an evaluation that are plain numbers."""


def evaluation_to_message(evaluation: GraspEvaluation, stamp: Time) -> msg.GraspEvaluation:
    """Return the message of an evaluation.

    Args:
        evaluation: Result of one grasp.
        stamp: Start of the run plus simulated time.
    """
    message = msg.GraspEvaluation(
        grasp_id=evaluation.grasp_id,
        grasp_index=evaluation.grasp_index,
        result=msg.Result(code=evaluation.code, message=evaluation.message),
        features=fill(msg.GraspFeatures(), evaluation.features),
        metrics=fill(msg.GraspMetrics(), evaluation.metrics),
        contacts=[contact_to_message(contact) for contact in evaluation.contacts or ()],
        palm_force=vector_message(evaluation.palm_force),
        solver=fill(msg.SolverReport(), evaluation.solver),
        fields=[field_to_message(*item) for item in evaluation.fields.items()],
        pickup=_list(evaluation.pickup, pickup_to_message),
        reorientation=_list(evaluation.reorientation, reorientation_to_message),
        linear_acceleration=_list(evaluation.linear_acceleration, acceleration_to_message),
        angular_acceleration=_list(evaluation.angular_acceleration, acceleration_to_message),
        squeeze=_list(evaluation.squeeze, squeeze_to_message),
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
        palm_force=vector_from_message(message.palm_force),
        solver=extract(SolverReport, message.solver),
        fields={field.stage: field_from_message(field) for field in message.fields},
        pickup=_single(message.pickup, pickup_from_message),
        reorientation=_single(message.reorientation, reorientation_from_message),
        linear_acceleration=_single(message.linear_acceleration, acceleration_from_message),
        angular_acceleration=_single(message.angular_acceleration, acceleration_from_message),
        squeeze=_single(message.squeeze, squeeze_from_message),
        **{name: getattr(message, name) for name in NUMBERS},
    )


def _list(result: Source | None, convert: Callable[[Source], Target]) -> list[Target]:
    """Return a result that may be missing as a message field takes it."""
    return [] if result is None else [convert(result)]


def _single(messages: Sequence[Source], convert: Callable[[Source], Target]) -> Target | None:
    """Return the result of a message field of at most one."""
    return convert(messages[0]) if messages else None
