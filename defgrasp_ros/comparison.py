"""What differs between two evaluations of the same grasps."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import GraspFeatures, GraspMetrics

UNFINISHED = (ResultCode.CANCELED, ResultCode.TIMEOUT)
"""Outcomes that say nothing about the grasp."""


@dataclass(frozen=True)
class GraspRecord:
    """What is compared of a grasp's evaluation."""

    grasp_id: str
    code: ResultCode
    metrics: GraspMetrics
    features: GraspFeatures


@dataclass(frozen=True)
class Difference:
    """A number of the first evaluation beside that of the second; NaN: not measured."""

    name: str
    first: float
    second: float

    @property
    def relative(self) -> float:
        """Difference over the larger of both amounts [-]; infinite where only one was measured."""
        if self.first == self.second:
            return 0.0
        relative = abs(self.second - self.first) / max(abs(self.first), abs(self.second))
        return math.inf if math.isnan(relative) else relative


@dataclass(frozen=True)
class GraspComparison:
    """One grasp in both evaluations; None where it is missing in the first."""

    grasp_index: int
    grasp_id: str
    first_code: ResultCode | None
    second_code: ResultCode
    differences: tuple[Difference, ...]
    """Metrics and features that at least one of them measured."""

    @property
    def same_outcome(self) -> bool:
        """Whether both ended alike, or the first did not end."""
        return self.first_code in (None, *UNFINISHED, self.second_code)

    @property
    def largest(self) -> Difference | None:
        """What differs most; None where nothing can be compared."""
        return max(self.differences, key=lambda difference: difference.relative, default=None)

    def document(self) -> dict[str, Any]:
        """Return everything as plain JSON types; null: not measured, or not comparable."""
        return {
            "grasp_index": self.grasp_index,
            "grasp_id": self.grasp_id,
            "recorded_outcome": self.first_code.name if self.first_code is not None else None,
            "repeated_outcome": self.second_code.name,
            "same_outcome": self.same_outcome,
            "differences": {
                each.name: {
                    "recorded": _finite(each.first),
                    "repeated": _finite(each.second),
                    "relative": _finite(each.relative),
                }
                for each in self.differences
            },
        }


def compare(first: Mapping[int, GraspRecord], second: Mapping[int, GraspRecord]) -> list[GraspComparison]:
    """Compare evaluations of the same grasps, by their indices; those that only the first has are left out."""
    return [_compared(index, first.get(index), second[index]) for index in sorted(second)]


def _compared(index: int, first: GraspRecord | None, second: GraspRecord) -> GraspComparison:
    if first is None or first.code in UNFINISHED:
        return GraspComparison(index, second.grasp_id, first and first.code, second.code, ())
    numbers = zip(_numbers(first), _numbers(second), strict=True)
    differences = (Difference(name, before, after) for (name, before), (_, after) in numbers)
    measured = tuple(each for each in differences if not (math.isnan(each.first) and math.isnan(each.second)))
    return GraspComparison(index, second.grasp_id, first.code, second.code, measured)


def _numbers(record: GraspRecord) -> Iterator[tuple[str, float]]:
    groups: Iterable[Any] = (record.metrics, record.features)
    for group in groups:
        for item in dataclasses.fields(group):
            value = getattr(group, item.name)
            if not isinstance(value, bool):
                yield item.name, float(value)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
