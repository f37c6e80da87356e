"""Two routines of LAPACK, called so that other threads go on: SciPy's own wrappers hold the interpreter meanwhile.

A large object keeps them busy for many seconds, in which a process could neither answer nor be canceled.
"""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
import scipy.linalg.cython_lapack


def inverse_of_positive_definite(matrix: np.ndarray) -> np.ndarray | None:
    """Return the inverse of a symmetric positive definite matrix, in the same memory.

    Args:
        matrix: Contiguous, shape ``(n, n)``; overwritten.

    Returns:
        The inverse, both triangles; None if the matrix is not positive definite.
    """
    n, leading = ctypes.c_int(len(matrix)), ctypes.c_int(max(1, len(matrix)))
    data = matrix.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
    # LAPACK counts by columns, so its lower triangle is the upper one of the array.
    for name in ("dpotrf", "dpotri"):
        info = ctypes.c_int()
        _routine(name)(b"L", ctypes.byref(n), data, ctypes.byref(leading), ctypes.byref(info))
        if info.value:
            return None
    for row in range(len(matrix)):
        matrix[row + 1 :, row] = matrix[row, row + 1 :]
    return matrix


@cache
def _routine(name: str) -> ctypes._CFuncPtr:
    """Return a routine of the LAPACK that SciPy is linked with; ``ctypes`` lets go of the interpreter in a call."""
    capsule = scipy.linalg.cython_lapack.__pyx_capi__[name]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    integer, number = ctypes.POINTER(ctypes.c_int), ctypes.POINTER(ctypes.c_double)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_char_p, integer, number, integer, integer)
    return kind(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))
