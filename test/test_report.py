"""Tables and reasons for people: what is a bound is marked, what is missing is explained."""

from __future__ import annotations

import numpy as np
import pytest
from rich.console import Console

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import (
    AccelerationResult,
    GraspEvaluation,
    GraspMetrics,
    ReorientationResult,
    SqueezeResult,
)
from defgrasp_ros.report import evaluation_document, evaluation_table, feature_table, reasons


def acceleration(at_loss, bounds=(), texts=("", "", "")) -> AccelerationResult:
    """Three directions."""
    mask = np.isin(np.arange(3), bounds)
    return AccelerationResult(np.eye(3), np.array(at_loss), np.full(3, np.nan), mask, list(texts))


def reorientation(texts=("", "", "")) -> ReorientationResult:
    numbers = np.where(np.array(texts)[:, None] == "", np.ones((3, 4)), np.nan)
    return ReorientationResult(np.eye(3), 2.0, numbers, numbers, numbers, numbers, list(texts))


def text_of(table) -> str:
    console = Console(width=100)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def held(**experiments) -> GraspEvaluation:
    metrics = GraspMetrics(True, 1e3, 1e-3, 1e-3, linear_instability=20.0, angular_instability=300.0)
    return GraspEvaluation(0, "top", metrics=metrics, **experiments)


def test_lower_bound_is_marked():
    """A mean is a lower bound as soon as one direction is; without one it stands alone."""
    bounded = held(linear_acceleration=acceleration([10.0, 20.0, 30.0], bounds=[2]))
    exact = held(linear_acceleration=acceleration([10.0, 20.0, 30.0]))
    assert ">=20" in text_of(evaluation_table([bounded]))
    assert "20" in text_of(evaluation_table([exact])) and ">=" not in text_of(evaluation_table([exact]))


def test_missing_mean_is_no_bound():
    """Where a direction has no number there is no mean, and nothing to mark."""
    evaluation = held(linear_acceleration=acceleration([10.0, np.nan, 50.0], [2], ["", "no solution", ""]))
    evaluation.metrics.linear_instability = evaluation.linear_acceleration.instability
    assert ">=" not in text_of(evaluation_table([evaluation]))
    assert evaluation_document(evaluation)["linear_acceleration"]["at_loss"] == [10.0, None, 50.0]
    assert evaluation_document(evaluation)["metrics"]["linear_instability"] is None


def test_columns_are_those_of_the_experiments():
    """An experiment that was not done has no column."""
    plain = text_of(evaluation_table([held()]))
    assert "rad/s^2" not in plain and "turned" not in plain
    both = text_of(evaluation_table([held(), held(angular_acceleration=acceleration([1.0, 2.0, 3.0]))]))
    assert "rad/s^2" in both and "turned" not in both


def test_reasons_are_told_once_for_all_directions():
    """Equal reasons are one line with their number; what went well needs none."""
    assert reasons(held(reorientation=reorientation(), linear_acceleration=acceleration([1.0, 2.0, 3.0]))) == []
    nothing = np.full(2, np.nan)
    evaluation = held(
        reorientation=reorientation(["slipped", "slipped", ""]),
        linear_acceleration=acceleration([1.0, np.nan, np.nan], (), ["", "no solution", "canceled"]),
        squeeze=SqueezeResult(nothing, nothing, nothing, nothing, nothing, reason="at 3 N: squeezed out"),
    )
    assert reasons(evaluation) == [
        "reorientation, 2 of 3 axes: slipped",
        "linear acceleration, 1 of 3 directions: no solution",
        "linear acceleration, 1 of 3 directions: canceled",
        "squeeze at 3 N: squeezed out",
    ]


def test_reason_of_a_failed_pickup_comes_first():
    """A grasp that was not held says why, and so does its squeeze."""
    failed = GraspEvaluation(0, "top", ResultCode.DROPPED, "it slipped")
    assert reasons(failed) == ["it slipped"]


@pytest.mark.parametrize("table", [evaluation_table, feature_table])
def test_nothing_measured_is_a_dash(table):
    """NaN is never a number in a table."""
    text = text_of(table([GraspEvaluation(0, "top", ResultCode.NO_CONTACT)]))
    assert "nan" not in text and " - " in text
