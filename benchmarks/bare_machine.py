"""Lets the simulator run where Python, Warp, NumPy and SciPy are all there is; import it before NumPy."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
import types


def stand_in_for_threadpoolctl() -> None:
    """Give BLAS one thread from the start where the library is missing with which the simulator does that."""
    if importlib.util.find_spec("threadpoolctl"):
        return
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"

    class ThreadpoolController:
        @contextlib.contextmanager
        def limit(self, **_):
            yield

    module = types.ModuleType("threadpoolctl")
    module.ThreadpoolController = ThreadpoolController
    sys.modules["threadpoolctl"] = module


stand_in_for_threadpoolctl()
