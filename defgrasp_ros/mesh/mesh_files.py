"""Reads object meshes from files of the usual formats."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError, NotFoundError
from defgrasp_ros.mesh.limited_process import WorkerError, run_worker
from defgrasp_ros.mesh.object_mesh import PreparedMesh, prepare_surface, prepare_tetrahedra, scaled_surface
from defgrasp_ros.mesh.tet_mesh import TET_EDGES, TetMesh

if TYPE_CHECKING:
    import trimesh

SURFACE_FORMATS = ("stl", "obj", "ply", "off", "glb", "gltf")
TEXT_FORMATS = ("tet", "mesh")
MESHIO_FORMATS = ("msh", "vtk", "vtu")
MESH_FORMATS = (*TEXT_FORMATS, *SURFACE_FORMATS, *MESHIO_FORMATS)
"""What can be read: tetrahedra as of DefGraspSim (tet); tetrahedra or triangles of MEDIT (mesh), Gmsh (msh) and VTK
(vtk, vtu); triangles in the others."""

ORDER_BY_NODES = {4: 1, 10: 2}
"""Element order of tetrahedra with so many nodes."""

STRAIGHT = 1e-3
"""Distance of a node from the middle of its edge that is none, relative to the largest element [-]."""

PLAIN_FORMATS = ("stl", "obj", "ply", "off")
"""Formats without compression or links, in which nothing is larger than the file; read in this process."""

MAX_FILE_SIZE = 500 * 2**20
"""Larger files are refused unread [B]."""

PARSE_TIME_LIMIT = 60.0
"""Time after which reading a file is given up [s]."""

PARSE_MEMORY_LIMIT = 2 * 2**30
"""Address space of the process that reads other formats [B]."""

PARSE_WORKER = Path(__file__).with_name("parse_worker.py")
Result = TypeVar("Result")


def read_mesh(
    path: Path | str,
    *,
    scale: float = 1.0,
    target_edge_length: float | None = None,
    wall_thickness: float | None = None,
    edge_radius: float | None = None,
    element_order: int | None = None,
) -> TetMesh:
    """Read an object from a file; a surface is filled with tetrahedra.

    Args:
        path: File with one of the extensions in ``MESH_FORMATS``, in capitals or not.
        scale: Factor from the file's unit to metres, e.g. 0.001 for millimetres.
        target_edge_length: Edge length of tetrahedra made here [m]; None: for about 1 000 nodes. Tetrahedra that
            the file holds are taken as they are.
        wall_thickness: Makes a surface the outside of a hollow object with walls so thick [m]; None: a solid.
        edge_radius: Radius with which sharp edges of a surface are rounded [m]; None: they stay sharp.
        element_order: 1 or 2, see :class:`TetMesh`; None: 2 for tetrahedra that are made here, for those of the file
            1 if they have four nodes and 2 if they have ten.

    Raises:
        NotFoundError: If there is no such file.
        InvalidMeshError: If its format is unknown, it cannot be read, or holds no solid that can be simulated; of
            a class that says which fault it is, and naming the file.
    """
    return prepare_file(
        path,
        scale=scale,
        target_edge_length=target_edge_length,
        wall_thickness=wall_thickness,
        edge_radius=edge_radius,
        element_order=element_order,
    ).logged()


def read_mesh_bytes(data: bytes, format: str, **options: float | None) -> TetMesh:
    """Read an object from the contents of a file.

    Args:
        data: What the file holds.
        format: One of ``MESH_FORMATS``, in capitals or not, with or without the dot of an extension.
        options: Those of ``read_mesh``.

    Raises:
        InvalidMeshError: As in ``read_mesh``.
    """
    return prepare_bytes(data, format, **options).logged()


def prepare_file(path: Path | str, **options: float | None) -> PreparedMesh:
    """Read an object from a file as ``read_mesh`` does, and say what was found and mended on the way."""
    return _from_file(path, lambda data, format: prepare_bytes(data, format, **options))


def prepare_bytes(
    data: bytes, format: str, *, scale: float = 1.0, element_order: int | None = None, **options: float | None
) -> PreparedMesh:
    """Read an object from the contents of a file, and say what was found and mended on the way."""
    vertices, cells = parse_mesh(data, format)
    if cells.shape[1] == 3:
        return prepare_surface(vertices, cells, scale=scale, element_order=element_order, **options)
    order = ORDER_BY_NODES[cells.shape[1]] if element_order is None else element_order
    prepared = prepare_tetrahedra(vertices, cells[:, :4], scale=scale, element_order=order)
    return replace(prepared, warnings=(*prepared.warnings, *_curved_sides(vertices, cells)))


def _curved_sides(vertices: np.ndarray, cells: np.ndarray) -> list[str]:
    """Return a warning, or nothing, about nodes of tetrahedra that are not in the middle of their edges.

    Raises:
        InvalidMeshError: If there are no such nodes.
    """
    if cells.shape[1] == 4:
        return []
    if cells.min() < 0 or cells.max() >= len(vertices):
        raise InvalidMeshError(f"tetrahedra contain index {cells.max()}, but the mesh has {len(vertices)} vertices")
    distance = np.linalg.norm(vertices[cells[:, 4:]] - vertices[cells[:, TET_EDGES]].mean(axis=2), axis=-1)
    share = distance.max() / np.ptp(vertices[cells[:, :4]], axis=1).max()
    if share < STRAIGHT:
        return []
    return [f"sides of tetrahedra are curved, by up to {100.0 * share:.2g} % of their size: they are taken as straight"]


def read_surface(path: Path | str, *, scale: float = 1.0) -> trimesh.Trimesh:
    """Read the closed surface of an object from a file, without filling it; of tetrahedra, their boundary.

    Args:
        path: As in ``read_mesh``.
        scale: As in ``read_mesh``.

    Raises:
        NotFoundError: As in ``read_mesh``.
        InvalidMeshError: As in ``read_mesh``.
    """
    return _from_file(path, lambda data, format: _surface_of(*parse_mesh(data, format), scale))


def parse_mesh(data: bytes, format: str) -> tuple[np.ndarray, np.ndarray]:
    """Return what a file holds, as it is: nothing is scaled, mended or filled.

    Returns:
        Vertices in the file's unit, shape ``(vertex, 3)``, and tetrahedra, shape ``(tet, 4)`` or, corners first,
        ``(tet, 10)``; or triangles, shape ``(triangle, 3)``, where there are no tetrahedra.

    Raises:
        InvalidMeshError: If the format is unknown or the data cannot be read.
    """
    format = format.lower().removeprefix(".")
    if format not in MESH_FORMATS:
        raise InvalidMeshError(f"mesh format '{format}' is unknown; known: {', '.join(MESH_FORMATS)}")
    if not data:
        raise InvalidMeshError("the mesh is empty: 0 bytes")
    if len(data) > MAX_FILE_SIZE:
        raise MeshTooLargeError(f"the file has {len(data)} bytes, more than {MAX_FILE_SIZE}; decimate the mesh")
    if format in TEXT_FORMATS:
        return {"tet": _parse_tet, "mesh": _parse_medit}[format](data.decode(errors="replace"))
    vertices, cells, kinds = _parse_plain(data, format) if format in PLAIN_FORMATS else _parse_apart(data, format)
    if len(cells) == 0 and format in SURFACE_FORMATS:
        raise InvalidMeshError(f"holds no triangles that can be read as {format}")
    if len(cells) == 0:
        raise InvalidMeshError(
            "holds neither tetrahedra of four or ten nodes (tetra, tetra10) nor triangles (triangle), but "
            f"{', '.join(kinds) or 'no elements'}"
        )
    return vertices, cells


def _from_file(path: Path | str, use: Callable[[bytes, str], Result]) -> Result:
    """Hand the contents of a file on; errors name the file."""
    path = Path(path)
    if not path.is_file():
        raise NotFoundError(f"mesh file '{path}' does not exist" if not path.exists() else f"'{path}' is not a file")
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise MeshTooLargeError(f"has more than {MAX_FILE_SIZE} bytes; decimate the mesh")
        return use(path.read_bytes(), path.suffix)
    except InvalidMeshError as error:
        raise type(error)(f"{path}: {error}") from error
    except OSError as error:
        raise InvalidMeshError(f"{path}: cannot be read: {error.strerror}") from error


def _surface_of(vertices: np.ndarray, cells: np.ndarray, scale: float) -> trimesh.Trimesh:
    import trimesh

    if cells.shape[1] == 3:
        return scaled_surface(vertices, cells, scale)
    mesh = prepare_tetrahedra(vertices, cells[:, :4], scale=scale).mesh
    return trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False)


def _parse_tet(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Read lines ``v x y z`` and ``t i j k l`` (0-based); a label after them is ignored, # begins a comment."""
    vertices: list[list[float]] = []
    tetrahedra: list[list[int]] = []
    for number, line in enumerate(text.splitlines(), start=1):
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
    return np.array(vertices).reshape(-1, 3), _indices(tetrahedra, 4)


def _parse_medit(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Read the ASCII format of MEDIT: keyword, count, then one row each, 1-based, with a label at its end."""
    words = iter(" ".join(line.split("#", 1)[0] for line in text.splitlines()).split())
    columns = {"Vertices": 3, "Triangles": 3, "Tetrahedra": 4}
    others = {"Edges": 2, "Quadrilaterals": 4, "Hexahedra": 8, "Corners": 0, "Ridges": 0, "RequiredVertices": 0}
    found: dict[str, np.ndarray] = {}
    try:
        for word in words:
            if word == "End":
                break
            if word in ("MeshVersionFormatted", "Dimension"):
                if next(words) != "3" and word == "Dimension":
                    raise InvalidMeshError("has Dimension other than 3; give a mesh in space")
                continue
            if word not in columns and word not in others:
                raise InvalidMeshError(f"keyword '{word[:40]}' is unknown; known: {', '.join([*columns, *others])}")
            width = {**columns, **others}[word] + 1
            count = int(next(words))
            if not 0 <= count <= len(text):
                raise InvalidMeshError(f"says that it has {count} {word}, more than the file can hold")
            rows = [float(next(words)) for _ in range(count * width)]
            found[word] = np.array(rows).reshape(count, width)[:, :-1]
    except (StopIteration, RuntimeError):
        raise InvalidMeshError(f"ends within '{word}'; the file is truncated") from None
    except ValueError as error:
        raise InvalidMeshError(f"'{word}' holds what is no number: {error}") from None
    if "Vertices" not in found:
        raise InvalidMeshError("holds no 'Vertices'")
    for kind in ("Tetrahedra", "Triangles"):
        if len(found.get(kind, ())):
            return found["Vertices"], found[kind].astype(np.int64) - 1
    raise InvalidMeshError("holds neither 'Tetrahedra' nor 'Triangles'")


def _indices(rows: list[list[int]], width: int) -> np.ndarray:
    try:
        return np.array(rows, dtype=np.int64).reshape(-1, width)
    except OverflowError:
        raise InvalidMeshError("holds a vertex index of more than 63 bits") from None


def _parse_plain(data: bytes, format: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    import trimesh

    try:
        surface = trimesh.load_mesh(io.BytesIO(data), file_type=format, process=False)
        return np.asarray(surface.vertices), np.asarray(surface.faces), []
    except Exception as error:
        raise InvalidMeshError(f"cannot be read as {format}: {error or type(error).__name__}") from error


def _parse_apart(data: bytes, format: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    request = {"data": np.frombuffer(data, dtype=np.uint8), "format": format}
    try:
        answer = run_worker(PARSE_WORKER, request, time_limit=PARSE_TIME_LIMIT, memory_limit=PARSE_MEMORY_LIMIT)
    except WorkerError as error:
        advice = "; buffers in other files are not read: pack it as glb" if format == "gltf" else ""
        raise InvalidMeshError(f"cannot be read as {format}: {error}{advice}") from error
    return answer["vertices"], answer["cells"], list(answer["kinds"])
