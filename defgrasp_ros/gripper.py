"""Description of a parallel-jaw gripper: pads, stroke and the offset of its tool centre point."""

from __future__ import annotations

from dataclasses import dataclass

import yaml

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import InvalidOptionsError, NotFoundError

DEFAULT_GRIPPER = "franka_hand"


@dataclass(frozen=True)
class Gripper:
    """Two rigid flat pads that move symmetrically along the closing axis (+-y of the grasp frame).

    The pad outline is a rectangle in the plane of the pad face, given in the grasp frame (see ``grasp.py``).

    Args:
        name: Name of the description.
        pad_half_width: Half the pad's flat face along x [m].
        pad_bottom: Proximal end of the flat face along z [m], usually negative.
        pad_top: Distal end of the flat face along z [m].
        tip: Distal end of the finger along z [m], from which edge_distance is measured.
        finger_thickness: Thickness of a finger behind its pad face [m].
        max_opening: Largest distance of a pad face from the grasp frame's origin [m].
        max_force: Largest SUM of the two pad normal forces [N].
        hand_to_tcp: Distance from the hand's base frame to the grasp frame along z [m].
        closing_speed: Speed of each free finger under the full target force [m/s].
    """

    name: str
    pad_half_width: float
    pad_bottom: float
    pad_top: float
    tip: float
    finger_thickness: float
    max_opening: float
    max_force: float
    hand_to_tcp: float
    closing_speed: float

    def __post_init__(self) -> None:
        check = require_in_range
        error = InvalidOptionsError
        check(error, "gripper.pad_half_width", self.pad_half_width, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.pad_top", self.pad_top, self.pad_bottom, 1.0, low_open=True, unit="m")
        check(error, "gripper.tip", self.tip, self.pad_top, 1.0, unit="m")
        check(error, "gripper.finger_thickness", self.finger_thickness, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.max_opening", self.max_opening, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.max_force", self.max_force, 0.0, 1e5, low_open=True, unit="N")
        check(error, "gripper.hand_to_tcp", self.hand_to_tcp, 0.0, 1.0, unit="m")
        check(error, "gripper.closing_speed", self.closing_speed, 0.0, 10.0, low_open=True, unit="m/s")


def load_gripper(name: str = DEFAULT_GRIPPER) -> Gripper:
    """Read a gripper from ``config/grippers/<name>.yaml``.

    Raises:
        NotFoundError: If there is no such gripper.
        InvalidOptionsError: If a value in the file is missing, unknown or outside its range.
    """
    path = config_file(f"grippers/{name}.yaml")
    if not path.is_file():
        known = sorted(p.stem for p in path.parent.glob("*.yaml"))
        raise NotFoundError(f"gripper '{name}' is unknown; known: {', '.join(known)}")
    try:
        return Gripper(name=name, **yaml.safe_load(path.read_text()))
    except TypeError as error:
        raise InvalidOptionsError(f"{path}: {error}") from error
