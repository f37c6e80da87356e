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
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

Arrays = Mapping[str, np.ndarray]


class WorkerError(Exception):
    """The work ended without an answer; the text says why."""


class WorkerTimeoutError(WorkerError):
    """The work took too long."""


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
        try:
            process = subprocess.run(
                [sys.executable, str(script), *map(str, arguments)],
                cwd=directory,  # fTetWild leaves files of its own there
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                timeout=max(time_limit, 0.0),
                env=environment,
            )
        except subprocess.TimeoutExpired as error:
            raise WorkerTimeoutError(f"not finished in {time_limit:g} s") from error
        if process.returncode != 0:
            raise WorkerError(_reason(process))
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


def _reason(process: subprocess.CompletedProcess) -> str:
    if process.returncode < 0:
        return f"ended by {signal.Signals(-process.returncode).name}"
    lines = process.stderr.strip().splitlines()
    last = lines[-1] if lines else f"exit status {process.returncode}"
    return "not enough memory" if "MemoryError" in last else last
