"""The loaded contact points of one world, as the protocol looks at them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defgrasp_ros.evaluation import FINGER_NAMES, FingerContact
from defgrasp_ros.simulation.gross_slip import GROSS_SLIP_SHARE, mobilised_friction
from defgrasp_ros.simulation.kernels_faces import PALM


@dataclass
class ContactForces:
    """Points that carry force; vectors in the object frame, shape ``(contact, 3)``."""

    body: np.ndarray
    """0 left pad, 1 right pad, 2 platform, 3 palm, shape ``(contact,)``."""
    positions: np.ndarray
    normals: np.ndarray
    """Unit, from the body into the object."""
    forces: np.ndarray
    """On the object [N]."""
    nodes: np.ndarray
    """The nodes whose weighted mean the point is."""
    weights: np.ndarray
    friction: float

    def normal_force(self, body: int) -> float:
        """Sum of the normal forces of one body [N]."""
        mine = self.body == body
        return float(np.einsum("ij,ij->", self.forces[mine], self.normals[mine]))

    def force(self, body: int) -> np.ndarray:
        """Force of one body on the object [N], shape ``(3,)``."""
        return self.forces[self.body == body].sum(axis=0)

    def fingers(self) -> tuple[FingerContact, FingerContact]:
        """What the left and the right finger feel."""
        left, right = (self._finger(pad, name) for pad, name in enumerate(FINGER_NAMES))
        return left, right

    def palm(self) -> FingerContact:
        """What the palm feels."""
        return self._finger(PALM, "palm")

    def _finger(self, pad: int, name: str) -> FingerContact:
        mine = self.body == pad
        finger = FingerContact(name, self.positions[mine], self.normals[mine], self.forces[mine])
        finger.slipping = self.mobilised_friction(pad) > GROSS_SLIP_SHARE
        return finger

    def mobilised_friction(self, body: int) -> float:
        """Share of a body's sliding resistance that is used up [-]; see :mod:`gross_slip`."""
        mine = self.body == body
        return mobilised_friction(self.positions[mine], self.normals[mine], self.forces[mine], self.friction)
