"""Lists of worlds on the device, and launches over them."""

import numpy as np
import pytest
import warp as wp

from defgrasp_ros.simulation import rows as module
from defgrasp_ros.simulation.rows import Launcher, RowList, Rows, world_of

CPU = wp.get_device("cpu")
ROOM = 7


@wp.kernel
def _add(rows: Rows, summand: wp.array[int], total: wp.array[int]):
    """Add to the totals of worlds (world,)."""
    w = world_of(rows, wp.tid())
    if w >= 0:
        total[w] = total[w] + summand[w]


@pytest.fixture(params=["host", "device"])
def device(request, monkeypatch) -> wp.Device:
    """The CPU, with launches for as many rows as there are, or for as many as there is room for."""
    monkeypatch.setattr(module, "stays_on_device", lambda device: request.param == "device")
    return CPU


def selected(worlds: list[int], mark: list[int], *, needed: int = 0) -> list[int]:
    """Worlds with mark 1, put on a list that had others on it."""
    rows, chosen = RowList(ROOM, CPU).assign(np.array(worlds, dtype=int)), RowList(ROOM, CPU).assign(np.array([5, 6]))
    marks, space = (wp.array(values, dtype=int, device="cpu") for values in (mark, [needed]))
    chosen.select(rows, marks, 1, space, 3)
    return chosen.worlds.tolist()


def test_selection_keeps_the_order(device):
    """The worlds with the mark, in the order of the rows; others with the mark are not on the list."""
    assert selected([6, 0, 3, 2], [1, 1, 0, 1, 1, 0, 1]) == [6, 0, 3]
    assert selected([6, 0, 3, 2], [0] * ROOM) == []
    assert selected([], [1] * ROOM) == []


def test_nothing_is_selected_without_room(device):
    """A need above the room empties the list; one that fits does not."""
    assert selected([0, 1], [1] * ROOM, needed=4) == []
    assert selected([0, 1], [1] * ROOM, needed=3) == [0, 1]


def test_a_recorded_launch_follows_its_arguments(device):
    """Rows, their number and arrays may be others than in the first launch; what is beyond the rows is left alone."""
    launch, rows = Launcher(CPU), RowList(ROOM, CPU)
    ones, tens = (wp.full(ROOM, value, dtype=int, device="cpu") for value in (1, 10))
    first, second = (wp.zeros(ROOM, dtype=int, device="cpu") for _ in range(2))
    launch(_add, (rows.assign(np.array([2])),), [ones, first])
    launch(_add, (rows.assign(np.array([4, 0, 2])),), [tens, first])
    launch(_add, (rows.assign(np.array([], dtype=int)),), [tens, first])
    launch(_add, (RowList(ROOM, CPU).assign(np.array([1])),), [ones, second])
    assert first.numpy().tolist() == [10, 0, 11, 0, 10, 0, 0]
    assert second.numpy().tolist() == [0, 1, 0, 0, 0, 0, 0]
