"""When an object is still, and when it rests."""

from __future__ import annotations

import numpy as np

STILL_CHANGE = 1e-5
"""Motion in a quasi-static step, relative to the object's size, at which an object is still under its load [-]."""
REST_CHANGE = 1e-6
"""The same at which it rests [-]: metrics are measured there."""
LONG_STEP = 4
"""Time steps in a quasi-static step on the way to rest under a load that stays: what is free to move then gets there
16 times as fast, since a quasi-static step begins without velocity."""


class RestWatch:
    """Looks at the shapes of some worlds after each quasi-static step.

    Contact points that are equally good can take turns from step to step, at the edge of a pad for example. The shape
    then alternates between two, which is rest, too, where they are close.

    Args:
        positions: Nodes at the start [m], shape ``(n, node, 3)``.
        size: Of the object [m].
    """

    def __init__(self, positions: np.ndarray, size: float):
        self._last = positions.copy()
        self._before = np.full_like(positions, np.inf)
        self._size = size

    def resting(self, rows: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return which of the worlds rest after a step.

        Args:
            rows: Their rows among those of the start, shape ``(k,)``.
            positions: Their nodes now [m], shape ``(k, node, 3)``.
        """
        step = largest_motion(self._last[rows], positions)
        pair = largest_motion(self._before[rows], positions)
        self._before[rows], self._last[rows] = self._last[rows], positions
        rest, still = REST_CHANGE * self._size, STILL_CHANGE * self._size
        return (step < rest) | ((pair < rest) & (step < still))


def largest_motion(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Largest nodal displacement between two shapes [m], shape ``(n,)``, of arrays ``(n, node, 3)``."""
    return np.linalg.norm(after - before, axis=2).max(axis=1, initial=0.0)
