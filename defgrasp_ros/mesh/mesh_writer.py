"""Writes tetrahedra to files."""

from __future__ import annotations

from pathlib import Path

from defgrasp_ros.errors import InvalidMeshError
from defgrasp_ros.mesh.mesh_files import TEXT_FORMATS
from defgrasp_ros.mesh.tet_mesh import TetMesh

WRITTEN_FORMATS = ("tet", "mesh", "msh", "vtk", "vtu")
"""Formats of tetrahedra that can be written; ``read_mesh`` reads all of them."""


KINDS = {1: "tetra", 2: "tetra10"}
"""Names of the elements in formats that know both, by element order."""


def write_mesh(path: Path | str, mesh: TetMesh) -> None:
    """Write tetrahedra to a file whose extension is one of ``WRITTEN_FORMATS``.

    In ``TEXT_FORMATS`` an element has its corners alone, so that it is read with element order 1.

    Raises:
        InvalidMeshError: If the extension is unknown.
    """
    path = Path(path)
    format = path.suffix.lower().removeprefix(".")
    if format not in WRITTEN_FORMATS:
        raise InvalidMeshError(f"{path}: format '{format}' is not written; written: {', '.join(WRITTEN_FORMATS)}")
    if format in TEXT_FORMATS:
        path.write_text(_tet_text(mesh) if format == "tet" else medit_text(mesh))
        return
    import meshio

    names = {"msh": "gmsh22"}
    content = meshio.Mesh(mesh.vertices, [(KINDS[mesh.element_order], mesh.elements)])
    content.write(path, file_format=names.get(format, format))


def medit_text(mesh: TetMesh) -> str:
    """Return the ASCII format of MEDIT, with as many digits as read back to the same numbers."""
    vertices = [f"{x!r} {y!r} {z!r} 0" for x, y, z in mesh.corners.tolist()]
    tetrahedra = ["{} {} {} {} 0".format(*corners) for corners in (mesh.tetrahedra + 1).tolist()]
    head = ["MeshVersionFormatted 2", "Dimension 3"]
    sections = [["Vertices", str(len(vertices)), *vertices], ["Tetrahedra", str(len(tetrahedra)), *tetrahedra]]
    return "\n".join([*head, *sections[0], *sections[1], "End"]) + "\n"


def _tet_text(mesh: TetMesh) -> str:
    """Return the format of DefGraspSim."""
    lines = [f"# {len(mesh.corners)} vertices", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.corners)]
    lines += [f"# {len(mesh.tetrahedra)} tetrahedra", *("t {} {} {} {}".format(*tet) for tet in mesh.tetrahedra)]
    return "\n".join(lines) + "\n"
