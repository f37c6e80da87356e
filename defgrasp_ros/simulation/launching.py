"""Launches over many worlds that use all cores.

Warp runs a kernel on the CPU in one thread, without Python's lock. A launch over rows (worlds) is therefore cut into as
many pieces as there are cores, and each is run by its own thread. A row never shares a sum with another, so the number
of pieces does not change a bit of the result.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import warp as wp

MIN_PIECE = 4000
"""Kernel threads in a piece that are worth handing over: some 0.4 ms of work against 0.05 ms to start it."""


@dataclass(frozen=True, eq=False)
class Row:
    """Marks an argument of a kernel whose first axis is the row, so that a piece gets its own part of it."""

    array: wp.array


def launch_rows(
    kernel: wp.Kernel,
    dim: tuple[int, ...],
    inputs: Sequence,
    outputs: Sequence = (),
    *,
    device: wp.Device,
    threads: int | None = None,
) -> None:
    """Launch a kernel whose first index is the row; on the CPU, on several cores.

    Args:
        kernel: May write what belongs to its row or its row's world, nothing else.
        dim: Rows, and the further dimensions of the launch.
        inputs: As for ``wp.launch``; arrays with one entry per row are wrapped in :class:`Row`.
        outputs: The same.
        device: Warp device.
        threads: Largest number of pieces; None: one per core that the process may use.
    """
    pieces = 1
    if device.is_cpu:
        pieces = max(1, min(threads or core_count(), dim[0], math.prod(dim) // MIN_PIECE))
    bounds = [dim[0] * piece // pieces for piece in range(pieces + 1)]

    def command(first: int, last: int) -> wp.Launch:
        def part(argument):
            return argument.array[first:last] if isinstance(argument, Row) else argument

        return wp.launch(
            kernel,
            dim=(last - first, *dim[1:]),
            inputs=[part(argument) for argument in inputs],
            outputs=[part(argument) for argument in outputs],
            device=device,
            record_cmd=True,
        )

    commands = [command(first, last) for first, last in zip(bounds, bounds[1:], strict=False)]
    running = [_pool().submit(other.launch) for other in commands[1:]]
    commands[0].launch()
    for future in running:
        future.result()


@cache
def core_count() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(core_count(), thread_name_prefix="launch_rows")
