"""Results of the experiments, as messages (the evaluator's side) and back (the client's side)."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
from defgrasp_interfaces import msg

from defgrasp_ros.evaluation import AccelerationResult, Experiment, PickupCourse, ReorientationResult, SqueezeResult
from defgrasp_ros.ros.fields import flat, rows
from defgrasp_ros.ros.state_conversion import (
    contact_from_message,
    contact_to_message,
    field_from_message,
    field_to_message,
)

RECORDED = (
    "time",
    "opening",
    "left_normal_force",
    "right_normal_force",
    "platform_force",
    "slip",
    "max_von_mises_stress",
)
"""Arrays over the time of a pickup."""
TURNED = ("max_deformation", "max_deformation_from_lifted", "max_von_mises_stress", "strain_energy")
"""Arrays over axes and turns of a reorientation."""
SQUEEZED = ("force", "opening", "max_deformation", "max_von_mises_stress", "strain_energy")
"""Arrays over the forces of a squeeze."""


def pickup_to_message(course: PickupCourse) -> msg.PickupCourse:
    """Return the message of a pickup over time."""
    return msg.PickupCourse(phase=flat(course.phase, "B"), **_flat_fields(course, RECORDED))


def pickup_from_message(message: msg.PickupCourse) -> PickupCourse:
    """Return the pickup over time of a message."""
    arrays = {name: np.asarray(getattr(message, name)) for name in RECORDED}
    return PickupCourse(phase=np.asarray(message.phase), **arrays)


def acceleration_to_message(result: AccelerationResult) -> msg.AccelerationResult:
    """Return the message of a linear or an angular acceleration test."""
    return msg.AccelerationResult(
        is_lower_bound=result.is_lower_bound.tolist(),
        reasons=result.reasons,
        **_flat_fields(result, ("directions", "at_loss", "at_slip")),
    )


def acceleration_from_message(message: msg.AccelerationResult) -> AccelerationResult:
    """Return the acceleration test of a message."""
    return AccelerationResult(
        directions=rows(message.directions, 3),
        at_loss=np.asarray(message.at_loss),
        at_slip=np.asarray(message.at_slip),
        is_lower_bound=np.array(message.is_lower_bound, dtype=bool),
        reasons=list(message.reasons),
    )


def reorientation_to_message(result: ReorientationResult) -> msg.ReorientationResult:
    """Return the message of a reorientation."""
    return msg.ReorientationResult(
        closing_force=float(result.closing_force),
        reasons=result.reasons,
        states=[
            msg.ReorientationState(axis=axis, turn=turn, field=field_to_message(Experiment.REORIENTATION, state))
            for (axis, turn), state in result.states.items()
        ],
        **_flat_fields(result, ("directions", *TURNED)),
    )


def reorientation_from_message(message: msg.ReorientationResult) -> ReorientationResult:
    """Return the reorientation of a message."""
    shape = (len(message.reasons), -1)
    return ReorientationResult(
        directions=rows(message.directions, 3),
        closing_force=message.closing_force,
        reasons=list(message.reasons),
        states={(state.axis, state.turn): field_from_message(state.field) for state in message.states},
        **{name: np.asarray(getattr(message, name)).reshape(shape) for name in TURNED},
    )


def squeeze_to_message(result: SqueezeResult) -> msg.SqueezeResult:
    """Return the message of a squeeze."""
    return msg.SqueezeResult(
        contacts=[contact_to_message(contact) for fingers in result.contacts for contact in fingers],
        states=[field_to_message(Experiment.SQUEEZE, state) for state in result.states],
        reason=result.reason,
        **_flat_fields(result, SQUEEZED),
    )


def squeeze_from_message(message: msg.SqueezeResult) -> SqueezeResult:
    """Return the squeeze of a message."""
    contacts = [contact_from_message(contact) for contact in message.contacts]
    return SqueezeResult(
        contacts=list(zip(contacts[::2], contacts[1::2], strict=True)),
        states=[field_from_message(state) for state in message.states],
        reason=message.reason,
        **{name: np.asarray(getattr(message, name)) for name in SQUEEZED},
    )


def _flat_fields(result: Any, names: tuple[str, ...]) -> dict[str, array.array]:
    return {name: flat(getattr(result, name)) for name in names}
