"""Files inside a log: what was simulated, as other programs read it."""

from __future__ import annotations

from dataclasses import dataclass

from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.tet_mesh import TetMesh

MESH_FILE = "object.mesh"
"""The tetrahedra that were simulated, in the format of MEDIT."""

GRIPPER_FILE = "gripper.urdf"
"""The gripper, as boxes."""


@dataclass(frozen=True)
class Attachment:
    """A file inside a log."""

    name: str
    media_type: str
    data: bytes


def run_attachments(mesh: TetMesh, gripper: Gripper) -> list[Attachment]:
    """Return the files of a run: the object's tetrahedra [m], in the object frame, and the gripper."""
    from defgrasp_ros.gripper_urdf import gripper_urdf
    from defgrasp_ros.mesh.mesh_writer import medit_text

    return [
        Attachment(MESH_FILE, "text/plain", medit_text(mesh).encode()),
        Attachment(GRIPPER_FILE, "application/xml", gripper_urdf(gripper).encode()),
    ]
