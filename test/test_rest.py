"""When an object rests."""

import numpy as np
import pytest

from defgrasp_ros.experiments.rest import REST_CHANGE, STILL_CHANGE, RestWatch

SIZE = 0.1
START = np.zeros((1, 4, 3))


def steps_until_rest(motion, limit: int = 20) -> int | None:
    """Number of steps after which a world whose nodes are at ``motion(step)`` [m] along x rests."""
    watch = RestWatch(START, SIZE)
    for step in range(1, limit):
        if watch.resting(np.array([0]), START + [motion(step), 0.0, 0.0])[0]:
            return step
    return None


def test_decaying_motion_rests_when_its_steps_are_small():
    """Steps that halve from 1e-3 of the size rest at the first below 1e-6 of it."""
    count = steps_until_rest(lambda step: SIZE * 1e-3 * (1.0 - 0.5**step))
    assert 1e-3 * 0.5**count < REST_CHANGE <= 1e-3 * 0.5 ** (count - 1)


def test_two_shapes_that_take_turns_are_rest_if_they_are_close():
    """An alternation below the still limit rests at the second turn; a larger one never does."""
    assert steps_until_rest(lambda step: SIZE * 0.5 * STILL_CHANGE * (step % 2)) == 2
    assert steps_until_rest(lambda step: SIZE * 2.0 * STILL_CHANGE * (step % 2)) is None


@pytest.mark.parametrize("speed", [2.0 * REST_CHANGE, 1e-3])
def test_steady_creep_is_no_rest(speed):
    """A motion that goes on is none, however slow above the limit."""
    assert steps_until_rest(lambda step: SIZE * speed * step) is None
