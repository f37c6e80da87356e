"""Runs fTetWild in a process of its own: ``python tetwild_worker.py INPUT.npz OUTPUT.npz``.

Started by ``tetrahedralize.py``, never imported: a native mesher can hang, run out of memory, crash or print,
and none of that may reach the caller.
"""

import ctypes
import mmap
import platform
import resource
import sys

import numpy as np
import pytetwild

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


def main(input_path: str, output_path: str) -> None:
    """Read surface and parameters, write the tetrahedra."""
    with np.load(input_path) as request:
        memory, seconds = int(request["memory_limit"]), int(request["time_limit"])
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        # Ends this process also where the one that waits for it was killed.
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        make_repeatable(int(request["seed"]))
        vertices, tetrahedra = pytetwild.tetrahedralize(
            request["vertices"],
            request["triangles"].astype(np.int32),
            edge_length_abs=float(request["edge_length"]),
            epsilon=float(request["relative_envelope"]),
            simplify=False,
            num_threads=1,
        )
    np.savez(output_path, vertices=vertices, tetrahedra=tetrahedra)


if __name__ == "__main__":
    main(*sys.argv[1:])
