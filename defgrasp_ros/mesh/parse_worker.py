"""Reads a mesh file by trimesh or meshio; run by ``mesh_files.py`` in a process with limits.

Compressed or linked contents can be far larger than the file, and these readers believe what a file says of itself.
"""

import io
import tempfile
from collections.abc import Mapping

import numpy as np

from defgrasp_ros.mesh.limited_process import answer_request

MESHIO_READERS = {"msh": "gmsh", "vtk": "vtk", "vtu": "vtu"}


def parse(request: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return vertices, triangles or tetrahedra (``cells``), and the kinds of elements found."""
    data, format = request["data"].tobytes(), str(request["format"])
    return _by_meshio(data, format) if format in MESHIO_READERS else _by_trimesh(data, format)


def _by_trimesh(data: bytes, format: str) -> dict[str, np.ndarray]:
    import trimesh

    surface = trimesh.load_mesh(io.BytesIO(data), file_type=format, process=False, skip_materials=True)
    return {"vertices": surface.vertices, "cells": surface.faces, "kinds": np.array(["triangle"])}


def _by_meshio(data: bytes, format: str) -> dict[str, np.ndarray]:
    import importlib

    # Not meshio.read, which ends the process on a faulty file and hides the reason.
    reader = importlib.import_module(f"meshio.{MESHIO_READERS[format]}")
    with tempfile.NamedTemporaryFile(suffix=f".{format}", dir=".") as file:
        file.write(data)
        file.flush()
        content = reader.read(file.name)
    cells, kinds = content.cells_dict, sorted(content.cells_dict)
    if {"tetra", "tetra10"} <= cells.keys():
        raise ValueError("it holds tetrahedra of four and of ten nodes; give all of them the same order")
    chosen = next((cells[kind] for kind in ("tetra", "tetra10", "triangle") if kind in cells), np.empty((0, 0)))
    return {"vertices": content.points, "cells": chosen, "kinds": np.array(kinds)}


if __name__ == "__main__":
    answer_request(parse)
