"""Description of a parallel-jaw gripper: pads, palm, stroke and the offset of its tool centre point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import InvalidOptionsError, NotFoundError

DEFAULT_GRIPPER = "franka_hand"
ROUNDING = 1e-12
"""What sums of lengths may differ by [m]."""


@dataclass(frozen=True)
class Palm:
    """The flat face of the hand between the fingers: a rectangle, centred on the approach axis.

    Args:
        face: Where it is along z of the grasp frame [m], usually negative.
        half_width: Half its extent along x [m].
        half_length: Half its extent along y, the closing axis [m].
    """

    face: float
    half_width: float
    half_length: float

    def __post_init__(self) -> None:
        check, error = require_in_range, InvalidOptionsError
        check(error, "gripper.palm.face", self.face, -1.0, 1.0, unit="m")
        check(error, "gripper.palm.half_width", self.half_width, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.palm.half_length", self.half_length, 0.0, 1.0, low_open=True, unit="m")


@dataclass(frozen=True)
class Gripper:
    """Two rigid pads that move symmetrically along the closing axis (+-y of the grasp frame).

    A pad's face is flat within a rectangle in the plane y = const of the grasp frame (see ``grasp.py``). Fillets can
    round it off beyond: along both sides and at the distal end, the tip. Without them the edges are sharp.

    Args:
        name: Name of the description.
        pad_half_width: Half the pad's flat part along x [m].
        pad_bottom: Proximal end of the flat part along z [m], usually negative.
        pad_top: Distal end of the flat part along z [m].
        tip: Distal end of the finger along z [m], from which edge_distance is measured.
        finger_thickness: Thickness of a finger behind its pad face [m].
        max_opening: Largest distance of a pad face from the grasp frame's origin [m].
        max_force: Largest SUM of the two pad forces [N].
        hand_to_tcp: Distance from the hand's base frame to the grasp frame along z [m].
        closing_speed: Speed of each free finger under the full target force [m/s].
        side_fillet: Radius along both long edges of a pad [m]; 0: sharp.
        tip_fillet: Radius at the distal end of a pad [m]; 0: sharp.
        palm: The palm, or None if nothing shall touch it.
        hand_mass: Mass without the fingers [kg].
        finger_mass: Mass of each finger [kg].
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
    side_fillet: float = 0.0
    tip_fillet: float = 0.0
    palm: Palm | None = None
    hand_mass: float = 0.73
    finger_mass: float = 0.015

    def __post_init__(self) -> None:
        check = require_in_range
        error = InvalidOptionsError
        check(error, "gripper.pad_half_width", self.pad_half_width, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.pad_top", self.pad_top, self.pad_bottom, 1.0, low_open=True, unit="m")
        check(error, "gripper.finger_thickness", self.finger_thickness, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.side_fillet", self.side_fillet, 0.0, self.finger_thickness, unit="m")
        check(error, "gripper.tip_fillet", self.tip_fillet, 0.0, self.finger_thickness - self.side_fillet, unit="m")
        check(error, "gripper.tip", self.tip, self.pad_top + self.tip_fillet - ROUNDING, 1.0, unit="m")
        check(error, "gripper.max_opening", self.max_opening, 0.0, 1.0, low_open=True, unit="m")
        check(error, "gripper.max_force", self.max_force, 0.0, 1e5, low_open=True, unit="N")
        check(error, "gripper.hand_to_tcp", self.hand_to_tcp, 0.0, 1.0, unit="m")
        check(error, "gripper.closing_speed", self.closing_speed, 0.0, 10.0, low_open=True, unit="m/s")
        check(error, "gripper.hand_mass", self.hand_mass, 0.0, 1e3, low_open=True, unit="kg")
        check(error, "gripper.finger_mass", self.finger_mass, 0.0, 1e3, low_open=True, unit="kg")
        if self.palm:
            check(error, "gripper.palm.face", self.palm.face, -self.hand_to_tcp, self.pad_top, unit="m")

    @property
    def finger_half_width(self) -> float:
        """Half the extent of a finger along x [m]."""
        return self.pad_half_width + self.side_fillet

    def pad_drop(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return how far the pad's face lies behind its flat part [m] at places of the grasp frame [m].

        Beyond the outline it is what it is at the outline.
        """
        across = np.clip(np.abs(x) - self.pad_half_width, 0.0, self.side_fillet)
        along = np.clip(z - self.pad_top, 0.0, self.tip_fillet)
        side = self.side_fillet - np.sqrt(self.side_fillet**2 - across**2)
        return side + self.tip_fillet - np.sqrt(self.tip_fillet**2 - along**2)


def gripper_names() -> list[str]:
    """Return the names of the descriptions in ``config/grippers``."""
    return sorted(path.stem for path in config_file(f"grippers/{DEFAULT_GRIPPER}.yaml").parent.glob("*.yaml"))


def load_gripper(name: str = DEFAULT_GRIPPER) -> Gripper:
    """Read a gripper from ``config/grippers/<name>.yaml``.

    Raises:
        NotFoundError: If there is no such gripper.
        InvalidOptionsError: If a value in the file is missing, unknown or outside its range.
    """
    import yaml

    path = config_file(f"grippers/{name}.yaml")
    if name not in gripper_names():
        raise NotFoundError(f"gripper '{name}' is unknown; known: {', '.join(gripper_names())}")
    try:
        return gripper_from_values({"name": name, **yaml.safe_load(path.read_text())})
    except TypeError as error:
        raise InvalidOptionsError(f"{path}: {error}") from error


def gripper_from_values(values: Mapping[str, Any]) -> Gripper:
    """Return a gripper from the values of its fields, those of the palm as a group of their own; the inverse of
    ``dataclasses.asdict``.

    Raises:
        InvalidOptionsError: If a value is outside its range.
        TypeError: If a value is missing or unknown.
    """
    palm = values.get("palm")
    if palm is not None and not isinstance(palm, dict):
        raise InvalidOptionsError(f"gripper.palm = {palm!r} is not a group of face, half_width and half_length")
    return Gripper(**{**values, "palm": None if palm is None else Palm(**palm)})
