"""A logged run as what its evaluation needs, to repeat it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from defgrasp_ros.comparison import GraspRecord
from defgrasp_ros.errors import RecordingError
from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.recording import read_log, run_inputs
from defgrasp_ros.recording.attachments import MESH_FILE
from defgrasp_ros.ros.evaluation_run import CheckedGrasps, check_grasps
from defgrasp_ros.ros.request_conversion import material_from_message
from defgrasp_ros.ros.result_conversion import evaluation_from_message
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
        NotFoundError: If there is no such log.
        RecordingError: If the log cannot be read, or lacks what is needed to repeat the run.
        DefgraspError: If the request in the log is none that can be evaluated.
    """
    try:
        return _repeatable(log)
    except AttributeError as error:
        raise RecordingError(f"{log} was made with other message definitions than those here: {error}") from error


def record_of(evaluation: GraspEvaluation) -> GraspRecord:
    """Return what is compared of an evaluation."""
    return GraspRecord(evaluation.grasp_id, evaluation.code, evaluation.metrics, evaluation.features)


def _repeatable(log: Path) -> RepeatableRun:
    request_name, evaluations_name = relative_name(REQUEST), relative_name(EVALUATIONS)
    run = read_log(log, request_name, evaluations_name, convert={evaluations_name: _numbers})
    requests = run.on(request_name)
    if len(requests) != 1:
        raise RecordingError(f"{run.path} has {len(requests)} requests, so the run cannot be repeated")
    (request,) = requests
    inputs = run_inputs(run)
    if inputs.mesh is None:
        raise RecordingError(f"{run.path} has no {MESH_FILE}, so the run cannot be repeated")
    parameters = yaml.safe_load(run.provenance["parameters"])
    return RepeatableRun(
        object_model=ObjectModel(request.object.name, inputs.mesh, material_from_message(request.object.material)),
        grasps=check_grasps(request.grasps, parameters["max_grasps"]),
        gripper=inputs.gripper,
        options=inputs.options,
        device=run.provenance["device"],
        provenance=run.provenance,
        recorded={each.grasp_index: record_of(each) for each in run.on(evaluations_name)},
    )


def _numbers(message: Any) -> GraspEvaluation:
    return evaluation_from_message(message).without_fields()
