"""The colours of pictures, pages and markers: scales of stress, deformation and acceleration, and of single things."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

STRESS_COLORS, STRESS_COLOR_RANGE = "magma_r", (0.03, 0.86)
"""A colour map from light to dark, without its ends, in which shading would not show."""
STRESS_EXPONENT = 0.5
"""Colour grows with this power of the stress: most of a grasped body bears a small fraction of the peak."""
DEFORMATION_COLORS, DEFORMATION_COLOR_RANGE = "YlGnBu", (0.05, 0.95)
ACCELERATION_COLORS, ACCELERATION_COLOR_RANGE = "plasma", (0.14, 0.95)
PEAK_PERCENTILE = 99.5
"""Of the nodes; what lies above has the last colour, so that one corner does not take the whole scale."""
SMALLEST_PEAK = 1e-12
"""So that a scale has an extent where everything is 0."""

AXIS_COLORS = ("#d62728", "#2ca02c", "#1f77b4")
"""Of x, y and z of the grasp frame."""
FORCE_COLOR, TEXT_COLOR = "#00838f", "#3c4043"
FINGER_COLOR, PLATFORM_COLOR = np.array([0.45, 0.55, 0.68]), np.array([0.9, 0.91, 0.93])


def stress_scale(fields: Iterable[np.ndarray]) -> ScalarMappable | None:
    """Return one scale for nodal stresses [Pa] of several pictures; None if there are no pictures."""
    return _field_scale(fields, STRESS_COLORS, STRESS_COLOR_RANGE, STRESS_EXPONENT)


def deformation_scale(fields: Iterable[np.ndarray]) -> ScalarMappable | None:
    """Return one scale for nodal deformations [m] of several pictures; None if there are no pictures."""
    return _field_scale(fields, DEFORMATION_COLORS, DEFORMATION_COLOR_RANGE, 1.0)


def acceleration_scale(values: np.ndarray) -> ScalarMappable | None:
    """Return a scale from the smallest to the largest of the finite accelerations; None if there is none.

    Where they are all equal it begins at 0.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    low, high = float(finite.min()), float(finite.max())
    if high - low <= 1e-6 * abs(high):
        low = 0.0
    return _scale(ACCELERATION_COLORS, ACCELERATION_COLOR_RANGE, low, max(high, SMALLEST_PEAK), 1.0)


def round_numbers(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2 and 5 times a power of ten in the interval."""
    powers = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 1)
    return [step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0) if low <= step * 10.0**power <= high]


def _field_scale(
    fields: Iterable[np.ndarray], name: str, part: tuple[float, float], exponent: float
) -> ScalarMappable | None:
    peaks = [np.percentile(field, PEAK_PERCENTILE) for field in fields]
    return _scale(name, part, 0.0, max(*peaks, SMALLEST_PEAK), exponent) if peaks else None


def _scale(name: str, part: tuple[float, float], low: float, high: float, exponent: float) -> ScalarMappable:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, PowerNorm

    colors = ListedColormap(colormaps[name](np.linspace(*part, 256)))
    return ScalarMappable(PowerNorm(exponent, low, high, clip=True), colors)
