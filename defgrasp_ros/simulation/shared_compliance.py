"""The shared inverse on the device, one per step length."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np
import warp as wp

from defgrasp_ros.simulation.rest_system import RestSystem

ROTATION_TOLERANCE = 0.03
"""Nodal turn [rad] since the last refresh that a soft body's iteration bears well.

A stiff body bears less: a turn that the inverse does not know looks like a strain to it. The tolerance falls with
the ratio of the body's rigid to its elastic compliance.
"""

KEPT = 4
"""Step lengths whose inverses are kept: the time step, the long step, and what cuts make of them."""


@dataclass(frozen=True, eq=False)
class SharedCompliance:
    """P(h) of :mod:`rest_system` as device arrays."""

    step_length: float
    """h [s]."""
    matrix: wp.array
    """P [m/N], shape ``(3 node, 3 node)``."""
    elastic: wp.array
    """Local flexibility per node [m/N], shape ``(node,)``."""
    rotation_tolerance: float
    """Nodal turn after which the rotations are taken over anew [rad]."""


class ComplianceCache:
    """Makes the inverse of a step length when it is needed, and keeps those that were needed last."""

    def __init__(self, rest: RestSystem, device: wp.Device):
        self._rest = rest
        self._device = device
        self._known: dict[float, SharedCompliance] = {}
        """The one that was needed last stands at the end."""
        self._making = Lock()

    def __getitem__(self, step_length: float) -> SharedCompliance:
        with self._making:
            found = self._known.pop(step_length, None)
            if found is None:
                while len(self._known) >= KEPT:
                    del self._known[next(iter(self._known))]
                found = self._make(step_length)
            self._known[step_length] = found
            return found

    def _make(self, step_length: float) -> SharedCompliance:
        host = self._rest.compliance(step_length)
        return SharedCompliance(
            step_length=step_length,
            matrix=wp.array(host.matrix, dtype=wp.float64, device=self._device, copy=False),
            elastic=wp.array(host.elastic, dtype=wp.float64, device=self._device),
            rotation_tolerance=ROTATION_TOLERANCE / (1.0 + host.rigid / float(np.median(host.elastic))),
        )
