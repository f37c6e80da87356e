"""A run as its log tells it: object, grasps, results and what the fingers felt, in the package's own data classes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from defgrasp_ros.errors import DefgraspError, RecordingError, ResultCode
from defgrasp_ros.evaluation import FINGER_NAMES, EvaluationOptions, GraspEvaluation, PickupCourse
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.gripper_urdf import FINGER_JOINTS
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.recording import LoggedMessage, LoggedRun, read_log, run_inputs
from defgrasp_ros.recording.topic import NANOSECONDS

TOPICS = ("request", "status", "evaluations", "contacts", "joint_states", "all_joint_states")
"""What is read; points and markers only draw the rest again."""
NOT_FINISHED = "not finished: the log ends before its result"

PICKUP_FIELDS = (
    "opening",
    "left_normal_force",
    "right_normal_force",
    "platform_force",
    "slip",
    "max_von_mises_stress",
)
"""Curves of a ``PickupCourse``."""


@dataclass(frozen=True)
class TimeSeries:
    """What happened to one grasp over time; arrays of shape ``(sample,)``, nan where not recorded.

    ``values`` has the names and units of the fields of the message ``PickupCourse``.
    """

    time: np.ndarray
    """Simulated time [s]."""
    values: dict[str, np.ndarray]

    def has(self, name: str) -> bool:
        """Whether a curve has at least one number."""
        return name in self.values and bool(np.isfinite(self.values[name]).any())


@dataclass(frozen=True)
class RecordedGrasp:
    """One grasp of a run."""

    index: int
    """In the request."""
    id: str
    grasp: Grasp | None
    """None if the pose in the request has no meaning."""
    evaluation: GraspEvaluation
    """Where the log ends before it, one with code ``OPERATION_FAILED`` that says so."""
    samples: TimeSeries
    """From the messages on ``contacts`` and ``joint_states``; time since the start of the run [s]."""
    pickup: TimeSeries | None
    """From the evaluation; time since the start of the squeeze [s]; None where it has none."""

    @property
    def finished(self) -> bool:
        """Whether the log holds its result."""
        return self.evaluation.message != NOT_FINISHED

    @property
    def course(self) -> TimeSeries:
        """The pickup over time: as the evaluation has it, else as it was published."""
        return self.pickup or self.samples


@dataclass(frozen=True)
class RecordedRun:
    """Everything about a run."""

    name: str
    path: Path
    object_name: str
    material: Material
    mesh: TetMesh | None
    """None if the log does not hold the tetrahedra; ``notes`` says so."""
    gripper: Gripper
    options: EvaluationOptions
    """Those that were in force."""
    grasps: list[RecordedGrasp]
    """In the order of the request."""
    start_time: int
    """Start of the run [ns since the epoch]."""
    wall_time: float
    """From the first to the last message [s]."""
    provenance: dict[str, str]
    """Versions, device and parameters."""
    complete: bool
    """Whether the log was closed."""
    notes: list[str] = field(default_factory=list)
    """What is missing, and why."""

    @cached_property
    def model(self) -> ObjectModel | None:
        """Object and material; None without tetrahedra."""
        return self.mesh and ObjectModel(self.object_name, self.mesh, self.material)

    @property
    def held(self) -> list[RecordedGrasp]:
        """Grasps that were picked up and held."""
        return [grasp for grasp in self.grasps if grasp.evaluation.metrics.pickup_success]

    @property
    def versions(self) -> dict[str, str]:
        """Of this package and of those below it."""
        prefix = "version."
        return {key.removeprefix(prefix): text for key, text in self.provenance.items() if key.startswith(prefix)}


def load_run(path: Path) -> RecordedRun:
    """Read the log of a run, also one that was cut off.

    Args:
        path: The MCAP file, or the bag folder that holds it.

    Raises:
        NotFoundError: If there is no such log.
        RecordingError: If it cannot be read, or holds no request of an evaluator, or not how its run was made.
    """
    from defgrasp_ros.ros.request_conversion import material_from_message
    from defgrasp_ros.ros.result_conversion import evaluation_from_message

    try:
        log = read_log(path, *TOPICS, convert={"evaluations": evaluation_from_message})
    except AttributeError as error:
        raise RecordingError(f"{path} was made with other message definitions than those here: {error}") from error
    entry = next((entry for entry in log.messages if entry.topic.endswith("/request")), None)
    if entry is None:
        cause = "it ends before" if not log.complete else "it is no log of an evaluator"
        raise RecordingError(f"{log.path} holds no message on ~/request: {cause}")
    request, start = entry.message, entry.publish_time
    inputs = run_inputs(log)
    evaluations = {each.grasp_index: each for each in log.on("evaluations")}
    return RecordedRun(
        name=log.path.stem.removesuffix("_0"),
        path=log.path,
        object_name=request.object.name or "object",
        material=material_from_message(request.object.material),
        mesh=inputs.mesh,
        gripper=inputs.gripper,
        options=inputs.options,
        grasps=_grasps(log, request.grasps, start, evaluations),
        start_time=start,
        wall_time=(log.messages[-1].log_time - log.messages[0].log_time) / NANOSECONDS,
        provenance=log.provenance,
        complete=log.complete,
        notes=_notes(log, inputs.mesh, evaluations.values()),
    )


def _grasps(
    log: LoggedRun, requested: list, start: int, evaluations: dict[int, GraspEvaluation]
) -> list[RecordedGrasp]:
    from defgrasp_ros.ros.request_conversion import grasp_from_message

    contacts = defaultdict(list)
    for entry in log.messages:
        if entry.topic.endswith("/contacts"):
            contacts[entry.message.grasp_index].append(entry)
    openings = _openings(log, [message.id or str(index) for index, message in enumerate(requested)])
    grasps = []
    for index, message in enumerate(requested):
        try:
            grasp = grasp_from_message(message)
        except DefgraspError:  # its evaluation says what is wrong
            grasp = None
        missing = GraspEvaluation(index, message.id, code=ResultCode.OPERATION_FAILED, message=NOT_FINISHED)
        evaluation = evaluations.get(index, missing)
        grasps.append(
            RecordedGrasp(
                index=index,
                id=message.id or str(index),
                grasp=grasp,
                evaluation=evaluation,
                samples=_samples(contacts[index], openings[index], start),
                pickup=evaluation.pickup and _pickup(evaluation.pickup),
            )
        )
    return grasps


def _samples(contacts: list[LoggedMessage], openings: dict[int, float], start: int) -> TimeSeries:
    """Return the curves that the published messages of one grasp draw."""
    values = {name: np.full(len(contacts), np.nan) for name in PICKUP_FIELDS}
    for row, entry in enumerate(contacts):
        fingers = {finger.name: finger.normal_force for finger in entry.message.fingers}
        for name, finger in zip(("left_normal_force", "right_normal_force"), FINGER_NAMES, strict=True):
            values[name][row] = fingers.get(finger, np.nan)
        values["platform_force"][row] = entry.message.platform_force
        values["opening"][row] = openings.get(entry.publish_time, np.nan)
    return TimeSeries(np.array([(entry.publish_time - start) / NANOSECONDS for entry in contacts]), values)


def _openings(log: LoggedRun, ids: list[str]) -> dict[int, dict[int, float]]:
    """Return the position of the left finger by index of the grasp and time [m].

    Joint states know their grasp by its id alone. Where several have the same, those of one instant come in the order
    of its contacts; the joint states of the grasp that is shown could then be anyone's.
    """
    by_id: dict[tuple[str, int], list[float]] = defaultdict(list)
    for entry in log.messages:
        if entry.topic.endswith("/all_joint_states"):
            by_id[entry.message.header.frame_id, entry.publish_time].append(_opening(entry.message))
    for entry in log.messages:
        if entry.topic.endswith("/joint_states") and ids.count(entry.message.header.frame_id) == 1:
            by_id.setdefault((entry.message.header.frame_id, entry.publish_time), [_opening(entry.message)])
    openings: dict[int, dict[int, float]] = defaultdict(dict)
    for entry in log.messages:
        if entry.topic.endswith("/contacts"):
            index = entry.message.grasp_index
            if left := by_id.get((ids[index], entry.publish_time)):
                openings[index][entry.publish_time] = left.pop(0)
    return openings


def _opening(joints: Any) -> float:
    """Return the position of the left finger [m]; nan if the message has no such joint."""
    positions = dict(zip(joints.name, joints.position, strict=False))
    return positions.get(FINGER_JOINTS[0], np.nan)


def _pickup(course: PickupCourse) -> TimeSeries:
    return TimeSeries(course.time, {name: getattr(course, name) for name in PICKUP_FIELDS})


def _notes(log: LoggedRun, mesh: TetMesh | None, evaluations: Iterable[GraspEvaluation]) -> list[str]:
    """Return what is missing, and why."""
    notes = [] if log.complete else ["The log was not closed: it ends where its writer stopped."]
    if mesh is None:
        notes.append("The log does not hold the object's tetrahedra: fields over the mesh cannot be drawn.")
    elif not any(evaluation.fields for evaluation in evaluations):
        notes.append(
            "The log holds no fields over the mesh: no grasp was tried, or an older evaluator logged it without them."
        )
    return notes
