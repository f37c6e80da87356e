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
    found = {"vertices": content.points, "cells": np.empty((0, 0)), "kinds": np.array(sorted(content.cells_dict))}
    for kind in ("tetra", "tetra10", "triangle"):
        if kind in content.cells_dict:
            return {**found, "cells": content.cells_dict[kind]}
    return found


if __name__ == "__main__":
    answer_request(parse)
