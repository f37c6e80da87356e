"""What a run was made of, read from its log: the inverse of ``run_attachments`` and ``provenance``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.gripper import Gripper, gripper_from_values
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.recording.attachments import MESH_FILE
from defgrasp_ros.recording.read_log import LoggedRun


@dataclass(frozen=True)
class RunInputs:
    """Object, gripper and options of a run."""

    mesh: TetMesh | None
    """The tetrahedra that were simulated; None where a tool that copied the log has left out its files."""
    gripper: Gripper
    options: EvaluationOptions
    """Request, preset and parameters taken together."""


def run_inputs(run: LoggedRun) -> RunInputs:
    """Return what a run was made of.

    Raises:
        RecordingError: If the log does not say, or is of another version.
    """
    values = run.provenance
    if not {"gripper", "options", "element_order"} <= values.keys():
        raise RecordingError(f"{run.path} does not say with which gripper and options its run was made")
    try:
        return RunInputs(
            mesh=_mesh(run, int(values["element_order"])),
            gripper=gripper_from_values(yaml.safe_load(values["gripper"])),
            options=EvaluationOptions(**yaml.safe_load(values["options"])),
        )
    except TypeError as error:
        version = values.get("version.defgrasp_ros", "unknown")
        raise RecordingError(f"{run.path} was made by another version ({version}): {error}") from error


def _mesh(run: LoggedRun, element_order: int) -> TetMesh | None:
    from defgrasp_ros.mesh.mesh_files import parse_mesh

    file = run.attachments.get(MESH_FILE)
    return file and TetMesh(*parse_mesh(file.data, Path(MESH_FILE).suffix), element_order)
