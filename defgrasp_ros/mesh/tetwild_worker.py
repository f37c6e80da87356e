"""Runs fTetWild; started by ``tetrahedralize.py`` in a process with limits, never imported."""

import ctypes
import mmap
import platform
from collections.abc import Mapping

import numpy as np
import pytetwild

from defgrasp_ros.mesh.limited_process import answer_request

READ_WRITE_EXECUTE = 7


def return_constant(value: int) -> bytes:
    """Return the machine code of a function that returns ``value``, in [0, 65535]."""
    return {
        "x86_64": b"\xb8" + value.to_bytes(4, "little") + b"\xc3",  # mov eax, value; ret
        "aarch64": (0x52800000 | value << 5).to_bytes(4, "little") + bytes.fromhex("c0035fd6"),  # mov w0, #value; ret
    }[platform.machine()]


def make_repeatable(seed: int) -> None:
    """Let ``std::random_device`` return ``seed`` in this process, so that equal input gives equal tetrahedra.

    fTetWild inserts the triangles in an order shuffled by ``std::mt19937(std::random_device()())`` and offers no
    seed; it is its only source of chance. Where the function cannot be replaced (another architecture, a hardened
    system) the mesh is as good, but differs from run to run.
    """
    try:
        code = return_constant(seed)
        function = ctypes.CDLL("libstdc++.so.6")._ZNSt13random_device9_M_getvalEv
    except (KeyError, OSError, AttributeError):
        return
    address = ctypes.cast(function, ctypes.c_void_p).value
    page = address & -mmap.PAGESIZE
    length = address + len(code) - page
    if ctypes.CDLL(None).mprotect(ctypes.c_void_p(page), ctypes.c_size_t(length), READ_WRITE_EXECUTE) == 0:
        ctypes.memmove(address, code, len(code))


def tetrahedralize(request: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the tetrahedra of a surface."""
    make_repeatable(int(request["seed"]))
    vertices, tetrahedra = pytetwild.tetrahedralize(
        request["vertices"],
        request["triangles"].astype(np.int32),
        edge_length_abs=float(request["edge_length"]),
        epsilon=float(request["relative_envelope"]),
        simplify=False,
        num_threads=1,
    )
    return {"vertices": vertices, "tetrahedra": tetrahedra}


if __name__ == "__main__":
    answer_request(tetrahedralize)
