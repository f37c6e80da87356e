"""Runs work on untrusted or difficult meshes in a process of its own, with limits of time and memory.

A native mesher or a parser of a crafted file can hang, run out of memory, crash or print, and none of that may reach
the caller. The work is a script that calls ``answer_request``; arrays travel through files.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

import numpy as np

from defgrasp_ros.errors import CanceledError

Arrays = Mapping[str, np.ndarray]

LOOK_INTERVAL = 0.1
"""How often somebody who waits for a worker looks whether the work should end [s]."""

_should_stop: ContextVar[Callable[[], bool]] = ContextVar("should_stop", default=lambda: False)


class WorkerError(Exception):
    """The work ended without an answer; the text says why."""


class WorkerTimeoutError(WorkerError):
    """The work took too long."""


@contextmanager
def interruptible(should_stop: Callable[[], bool]) -> Iterator[None]:
    """Let workers of this thread be ended before they are done, with a ``CanceledError``, until the end of the block.

    Args:
        should_stop: Whether the work should end now.
    """
    token = _should_stop.set(should_stop)
    try:
        yield
    finally:
        _should_stop.reset(token)


def run_worker(script: Path, request: Mapping[str, object], *, time_limit: float, memory_limit: int) -> Arrays:
    """Run a script on a request and return its answer.

    Args:
        script: The worker; it calls ``answer_request``.
        request: Arrays and numbers by name.
        time_limit: Time after which it is stopped [s].
        memory_limit: Its address space [B].

    Raises:
        WorkerTimeoutError: If it did not finish in time.
        WorkerError: If it failed: the signal that ended it, or the last line that it wrote.
        CanceledError: If it was ended by ``interruptible``.
    """
    with tempfile.TemporaryDirectory(prefix="defgrasp_") as directory:
        question, answer = Path(directory, "request.npz"), Path(directory, "answer.npz")
        np.savez(question, allow_pickle=False, **request)
        # One thread: each thread of a numerics library reserves address space, which is limited.
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(os.path.abspath, filter(None, sys.path))),
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
        }
        arguments = [question, answer, memory_limit, max(1, int(np.ceil(time_limit)))]
        with subprocess.Popen(
            [sys.executable, str(script), *map(str, arguments)],
            cwd=directory,  # fTetWild leaves files of its own there
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=environment,
        ) as process:
            try:
                errors = _errors_of(process, time_limit)
            except BaseException:
                process.kill()
                raise
        if process.returncode != 0:
            raise WorkerError(_reason(process.returncode, errors))
        with np.load(answer) as arrays:
            return dict(arrays)


def answer_request(work: Callable[[Arrays], Arrays]) -> None:
    """Do the work of this process: the main function of a worker script."""
    import resource

    question, answer, memory, seconds = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    # Ends this process also where the one that waits for it was killed.
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    with np.load(question) as request:
        result = work(dict(request))
    np.savez(answer, allow_pickle=False, **result)


def _errors_of(process: subprocess.Popen, time_limit: float) -> str:
    """Wait until a process ends and return what it wrote."""
    deadline = time.monotonic() + time_limit
    while True:
        left = max(0.0, deadline - time.monotonic())
        try:
            return process.communicate(timeout=min(left, LOOK_INTERVAL))[1]
        except subprocess.TimeoutExpired as error:
            if _should_stop.get()():
                raise CanceledError("the mesh work was ended") from None
            if left <= LOOK_INTERVAL:
                raise WorkerTimeoutError(f"not finished in {time_limit:g} s") from error


def _reason(status: int, errors: str) -> str:
    if status < 0:
        return f"ended by {signal.Signals(-status).name}"
    lines = errors.strip().splitlines()
    last = lines[-1] if lines else f"exit status {status}"
    return "not enough memory" if "MemoryError" in last else last
