"""A logged run as what its evaluation needs, to repeat it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from defgrasp_ros.comparison import GraspRecord
from defgrasp_ros.errors import RecordingError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation, GraspFeatures, GraspMetrics
from defgrasp_ros.gripper import Gripper, gripper_from_values
from defgrasp_ros.mesh.mesh_files import parse_mesh
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.recording import LoggedRun, read_log
from defgrasp_ros.recording.attachments import MESH_FILE
from defgrasp_ros.ros.evaluation_run import CheckedGrasps, check_grasps
from defgrasp_ros.ros.fields import extract
from defgrasp_ros.ros.request_conversion import material_from_message
from defgrasp_ros.ros.topics import EVALUATIONS, REQUEST, relative_name


@dataclass(frozen=True)
class RepeatableRun:
    """What a run was asked, and what it answered."""

    object_model: ObjectModel
    """With the tetrahedra that were simulated, however the request gave its shape."""
    grasps: CheckedGrasps
    gripper: Gripper
    options: EvaluationOptions
    device: str
    provenance: dict[str, str]
    recorded: dict[int, GraspRecord]
    """The evaluations in the log, by index of the grasp in the request."""


def read_run(log: Path) -> RepeatableRun:
    """Read what a log says of its run.

    Raises:
        RecordingError: If the log cannot be read, or lacks what is needed to repeat the run.
        DefgraspError: If the request in the log is none that can be evaluated.
    """
    run = read_log(log, relative_name(REQUEST), relative_name(EVALUATIONS))
    requests = run.on(relative_name(REQUEST))
    if len(requests) != 1 or MESH_FILE not in run.attachments or "options" not in run.provenance:
        raise RecordingError(f"{run.path} has no request with mesh and gripper, so the run cannot be repeated")
    try:
        return _repeatable(run, requests[0])
    except (AttributeError, KeyError, TypeError) as error:
        version = run.provenance.get("version.defgrasp_ros", "unknown")
        raise RecordingError(f"{run.path} was made by another version ({version}): {error}") from error


def record_of(evaluation: GraspEvaluation) -> GraspRecord:
    """Return what is compared of an evaluation."""
    return GraspRecord(evaluation.grasp_id, evaluation.code, evaluation.metrics, evaluation.features)


def _repeatable(run: LoggedRun, request: object) -> RepeatableRun:
    parameters = yaml.safe_load(run.provenance["parameters"])
    order = int(run.provenance["element_order"])
    mesh = TetMesh(*parse_mesh(run.attachments[MESH_FILE].data, Path(MESH_FILE).suffix), element_order=order)
    recorded = {
        message.grasp_index: GraspRecord(
            message.grasp_id,
            ResultCode(message.result.code),
            extract(GraspMetrics, message.metrics),
            extract(GraspFeatures, message.features),
        )
        for message in run.on(relative_name(EVALUATIONS))
    }
    return RepeatableRun(
        object_model=ObjectModel(request.object.name, mesh, material_from_message(request.object.material)),
        grasps=check_grasps(request.grasps, parameters["max_grasps"]),
        gripper=gripper_from_values(yaml.safe_load(run.provenance["gripper"])),
        options=EvaluationOptions(**yaml.safe_load(run.provenance["options"])),
        device=run.provenance["device"],
        provenance=run.provenance,
        recorded=recorded,
    )
