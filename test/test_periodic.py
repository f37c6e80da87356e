"""What is done once per interval of simulated time."""

from __future__ import annotations

import pytest

from defgrasp_ros.periodic import Periodic


@pytest.mark.parametrize(("step", "each"), [(0.005, 4), (0.001, 20), (0.005, 2), (0.005, 20)])
def test_every_so_many_steps(step: float, each: int) -> None:
    """Time is a sum of steps that are no binary fractions; still each interval has the same number of them."""
    periodic, time, done = Periodic(each * step), 0.0, []
    for count in range(4000):
        if periodic.is_due(time):
            periodic.done(time)
            done.append(count)
        time += step
    assert done == list(range(0, 4000, each))


def test_never_again() -> None:
    """An interval without end is due once, at its start."""
    periodic = Periodic(float("inf"))
    assert periodic.is_due(2.0)
    periodic.done(2.0)
    assert not periodic.is_due(1e9)
