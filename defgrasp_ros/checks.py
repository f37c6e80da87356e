"""Range checks of numbers that cross the border of the package, with a text that names field and value."""

from __future__ import annotations

import math

from defgrasp_ros.errors import DefgraspError


def require_in_range(
    error: type[DefgraspError],
    name: str,
    value: float,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    low_open: bool = False,
    high_open: bool = False,
    unit: str = "",
) -> float:
    """Return ``value`` as a float if it is finite and inside the interval.

    Args:
        error: Exception class to raise.
        name: Field name for the message, as the caller wrote it.
        value: The number to check.
        low: Lower bound.
        high: Upper bound.
        low_open: Whether the lower bound itself is refused.
        high_open: Whether the upper bound itself is refused.
        unit: Unit for the message, e.g. ``"Pa"``.

    Raises:
        DefgraspError: Of class ``error``, naming field, value and allowed interval.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise error(f"{name} = {value!r} is not a number") from None
    below = number <= low if low_open else number < low
    above = number >= high if high_open else number > high
    if not math.isfinite(number) or below or above:
        suffix = f" {unit}" if unit else ""
        allowed = interval(low, high, low_open, high_open)
        raise error(f"{name} = {number:g}{suffix} is outside {allowed}{suffix}")
    return number


def interval(low: float, high: float, low_open: bool = False, high_open: bool = False) -> str:
    """Return an interval as text, e.g. ``"(0, 1]"``; infinite ends are open."""
    left = "(" if low_open or math.isinf(low) else "["
    right = ")" if high_open or math.isinf(high) else "]"
    return f"{left}{low:g}, {high:g}{right}"
