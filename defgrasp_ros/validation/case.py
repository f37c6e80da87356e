"""What a case is: a number that was measured beside the number that is right."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """One comparison; ``source`` says where the reference and the tolerance come from."""

    name: str
    measured: float
    reference: float
    error: float
    tolerance: float
    passed: bool
    source: str


@dataclass(frozen=True)
class Experiment:
    """A simulation that measures some cases on a device."""

    name: str
    measure: Callable[[str], Iterable[Case]]
    """Takes the name of a Warp device."""
    quick: bool = True
    """Whether it belongs to the quick set."""
    compares_devices: bool = False
    """Whether it needs a CUDA device beside the CPU."""


def relative(name: str, measured: float, reference: float, tolerance: float, source: str) -> Case:
    """Compare by |measured - reference| / |reference|."""
    return _case(name, measured, reference, abs(measured - reference) / abs(reference), tolerance, source)


def absolute(name: str, measured: float, reference: float, tolerance: float, source: str) -> Case:
    """Compare by |measured - reference|, in the unit of the two."""
    return _case(name, measured, reference, abs(measured - reference), tolerance, source)


def vanishing(name: str, measured: float, tolerance: float, source: str) -> Case:
    """Compare with zero: the error is |measured|."""
    return absolute(name, measured, 0.0, tolerance, source)


def failure(name: str, reason: str) -> Case:
    """The case of an experiment that did not come to an end."""
    return Case(name, math.nan, math.nan, math.nan, math.nan, False, reason)


def _case(name: str, measured: float, reference: float, error: float, tolerance: float, source: str) -> Case:
    passed = bool(error <= tolerance)  # false where the error is not a number
    return Case(name, float(measured), float(reference), float(error), float(tolerance), passed, source)
