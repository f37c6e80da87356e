"""Result codes and the exceptions that carry them.

Every way in which a request, or one grasp of it, can end has one number. The numbers are those of
``defgrasp_interfaces/msg/Result`` and never change meaning. An exception is raised where the fault is found,
with the field, the offending value and the way to mend it in its text; whoever answers the caller (the command
line, the node) turns it into its code.
"""

from __future__ import annotations

from enum import IntEnum


class ResultCode(IntEnum):
    """How a request or the evaluation of one grasp ended (mirrors ``defgrasp_interfaces/msg/Result``)."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    NOT_FOUND = 2
    INCORRECT_STATE = 3
    OPERATION_FAILED = 4

    CANCELED = 101
    TIMEOUT = 102
    RESOURCE_EXHAUSTED = 103

    INVALID_MESH = 110
    MESH_TOO_LARGE = 111
    TETRAHEDRALIZATION_FAILED = 112
    MESH_NOT_WATERTIGHT = 113

    INVALID_MATERIAL = 120

    INVALID_GRASP = 130
    UNKNOWN_FRAME = 131
    NO_CONTACT = 132
    FORCE_NOT_REACHED = 133
    DROPPED = 134
    GRIPPER_COLLISION = 135
    EMPTY_GRASP_LIST = 136
    TOO_MANY_GRASPS = 137

    INVALID_OPTIONS = 140
    SOLVER_DIVERGED = 150
    RECORDING_FAILED = 160


class DefgraspError(Exception):
    """Base of all errors that a caller can mend; ``code`` is what the interfaces report."""

    code = ResultCode.OPERATION_FAILED


class NotFoundError(DefgraspError):
    """A file, a gripper or a device of that name does not exist."""

    code = ResultCode.NOT_FOUND


class IncorrectStateError(DefgraspError):
    """What is asked for cannot be done in the present state."""

    code = ResultCode.INCORRECT_STATE


class ResourceExhaustedError(DefgraspError):
    """No room for more: in the queue, in memory or on the disk."""

    code = ResultCode.RESOURCE_EXHAUSTED


class InvalidMeshError(DefgraspError):
    """The object's mesh cannot be read, or is not a solid that can be simulated."""

    code = ResultCode.INVALID_MESH


class MeshTooLargeError(InvalidMeshError):
    """The mesh has more elements than the limit."""

    code = ResultCode.MESH_TOO_LARGE


class TetrahedralizationError(InvalidMeshError):
    """The surface is readable, but no tetrahedra could be made from it."""

    code = ResultCode.TETRAHEDRALIZATION_FAILED


class MeshingTimeoutError(TetrahedralizationError):
    """The mesher took too long; it would take longer with smaller elements."""


class MeshNotWatertightError(InvalidMeshError):
    """The surface has holes, so it encloses no volume."""

    code = ResultCode.MESH_NOT_WATERTIGHT


class InvalidMaterialError(DefgraspError):
    """A material parameter is outside its physical range."""

    code = ResultCode.INVALID_MATERIAL


class InvalidGraspError(DefgraspError):
    """A grasp pose or its target force has no meaning."""

    code = ResultCode.INVALID_GRASP


class UnknownFrameError(InvalidGraspError):
    """A grasp pose is given in a frame that is not known."""

    code = ResultCode.UNKNOWN_FRAME


class EmptyGraspListError(InvalidGraspError):
    """A request without any grasp."""

    code = ResultCode.EMPTY_GRASP_LIST


class TooManyGraspsError(InvalidGraspError):
    """More grasps in one request than the limit."""

    code = ResultCode.TOO_MANY_GRASPS


class InvalidOptionsError(DefgraspError):
    """An option of the experiment, the gripper or the solver is outside its range."""

    code = ResultCode.INVALID_OPTIONS


class RecordingError(DefgraspError):
    """The log of a run could not be written or read."""

    code = ResultCode.RECORDING_FAILED


class SolverDivergedError(DefgraspError):
    """The simulation found no solution of a time step, also not with smaller steps."""

    code = ResultCode.SOLVER_DIVERGED


class CanceledError(DefgraspError):
    """The caller asked for the evaluation to end."""

    code = ResultCode.CANCELED
