"""Reads object meshes from files of the usual formats."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np

from defgrasp_ros.errors import InvalidMeshError, NotFoundError
from defgrasp_ros.mesh.object_mesh import mesh_from_surface, mesh_from_tetrahedra
from defgrasp_ros.mesh.tet_mesh import TetMesh

SURFACE_FORMATS = ("stl", "obj", "ply", "off")
MESH_FORMATS = ("tet", *SURFACE_FORMATS, "msh")
"""What can be read: tetrahedra as of DefGraspSim (tet) and Gmsh (msh), surfaces in the others."""


def read_mesh(
    path: Path | str, *, scale: float = 1.0, target_edge_length: float | None = None, element_order: int = 1
) -> TetMesh:
    """Read an object from a file; a surface is filled with tetrahedra.

    Args:
        path: File with one of the extensions in ``MESH_FORMATS``, in capitals or not.
        scale: Factor from the file's unit to metres, e.g. 0.001 for millimetres.
        target_edge_length: Edge length of tetrahedra made here [m]; None: for about 1 000 nodes. Tetrahedra that
            the file holds are taken as they are.
        element_order: 1 or 2, see :class:`TetMesh`.

    Raises:
        NotFoundError: If there is no such file.
        InvalidMeshError: If its format is unknown, it cannot be read, or holds no solid that can be simulated; of
            a class that says which fault it is, and naming the file.
    """
    path = Path(path)
    if not path.is_file():
        raise NotFoundError(f"mesh file '{path}' does not exist" if not path.exists() else f"'{path}' is not a file")
    options = {"scale": scale, "target_edge_length": target_edge_length, "element_order": element_order}
    try:
        return read_mesh_bytes(path.read_bytes(), path.suffix, **options)
    except InvalidMeshError as error:
        raise type(error)(f"{path}: {error}") from error
    except OSError as error:
        raise InvalidMeshError(f"{path}: cannot be read: {error.strerror}") from error


def read_mesh_bytes(
    data: bytes,
    format: str,
    *,
    scale: float = 1.0,
    target_edge_length: float | None = None,
    element_order: int = 1,
) -> TetMesh:
    """Read an object from the contents of a file.

    Args:
        data: What the file holds.
        format: One of ``MESH_FORMATS``, in capitals or not, with or without the dot of an extension.
        scale: As in ``read_mesh``.
        target_edge_length: As in ``read_mesh``.
        element_order: As in ``read_mesh``.

    Raises:
        InvalidMeshError: As in ``read_mesh``.
    """
    format = format.lower().removeprefix(".")
    if format not in MESH_FORMATS:
        raise InvalidMeshError(f"mesh format '{format}' is unknown; known: {', '.join(MESH_FORMATS)}")
    if not data:
        raise InvalidMeshError("the mesh is empty: 0 bytes")
    if format == "tet":
        return mesh_from_tetrahedra(*_parse_tet(data), scale=scale, element_order=element_order)
    vertices, cells = _parse_msh(data) if format == "msh" else _parse_surface(data, format)
    if cells.shape[1] == 4:
        return mesh_from_tetrahedra(vertices, cells, scale=scale, element_order=element_order)
    options = {"target_edge_length": target_edge_length, "element_order": element_order}
    return mesh_from_surface(vertices, cells, scale=scale, **options)


def _parse_tet(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Read lines ``v x y z`` and ``t i j k l`` (0-based); a label after them is ignored, # begins a comment."""
    vertices: list[list[float]] = []
    tetrahedra: list[list[int]] = []
    for number, line in enumerate(data.decode(errors="replace").splitlines(), start=1):
        keyword, *values = line.split("#", 1)[0].split() or ["#"]
        try:
            if keyword == "v":
                x, y, z = values[:3]
                vertices.append([float(x), float(y), float(z)])
            elif keyword == "t":
                i, j, k, m = values[:4]
                tetrahedra.append([int(i), int(j), int(k), int(m)])
            elif keyword != "#":
                raise ValueError
        except ValueError:
            raise InvalidMeshError(
                f"line {number} is '{line.strip()[:60]}', expected 'v x y z' or 't i j k l'"
            ) from None
    return np.array(vertices).reshape(-1, 3), np.array(tetrahedra, dtype=np.int64).reshape(-1, 4)


def _parse_msh(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return the tetrahedra of a Gmsh file, or its triangles if it has no tetrahedra."""
    import meshio

    with tempfile.NamedTemporaryFile(suffix=".msh") as file:
        file.write(data)
        file.flush()
        try:
            # Not meshio.read, which ends the process on a faulty file.
            content = meshio.gmsh.read(file.name)
        except Exception as error:
            raise InvalidMeshError(f"cannot be read as msh: {error}") from error
    for cell_type in ("tetra", "triangle"):
        if cell_type in content.cells_dict:
            return content.points, content.cells_dict[cell_type]
    raise InvalidMeshError(
        "holds neither linear tetrahedra (tetra) nor triangles (triangle), but "
        f"{', '.join(sorted(content.cells_dict)) or 'no elements'}"
    )


def _parse_surface(data: bytes, format: str) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    try:
        surface = trimesh.load_mesh(io.BytesIO(data), file_type=format, process=False)
    except Exception as error:
        raise InvalidMeshError(f"cannot be read as {format}: {error}") from error
    triangles = np.asarray(getattr(surface, "faces", ()))
    if len(triangles) == 0:
        raise InvalidMeshError(f"holds no triangles that can be read as {format}")
    return np.asarray(surface.vertices), triangles
