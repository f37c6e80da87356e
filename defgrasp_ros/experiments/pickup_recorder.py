"""Keeps what a pickup looks like over time."""

from __future__ import annotations

import numpy as np

from defgrasp_ros.evaluation import GraspSample, PickupCourse


class PickupRecorder:
    """Collects the samples of one grasp."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []

    def add(self, sample: GraspSample, time: float, slip: float, max_von_mises_stress: float) -> None:
        """Add a sample, unless nothing has happened since the last one: calm worlds take long steps.

        Args:
            sample: State of the grasp.
            time: Since the start of the squeeze [s].
            slip: Since the target force was reached [m]; nan before.
            max_von_mises_stress: [Pa].
        """
        if self._rows and self._rows[-1][0] == time:
            return
        left, right = (finger.normal_force for finger in sample.contacts)
        row = (time, sample.phase, sample.opening, left, right, sample.platform_force, slip, max_von_mises_stress)
        self._rows.append(row)

    def course(self) -> PickupCourse | None:
        """Return the samples so far in the order of time; None without any."""
        return PickupCourse(*map(np.array, zip(*self._rows, strict=True))) if self._rows else None
