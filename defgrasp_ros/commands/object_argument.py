"""OBJECT on the command line: a mesh file, or the name of an object of the library."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from defgrasp_ros.errors import InvalidOptionsError
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.object_mesh import PreparedMesh

ObjectArgument = Annotated[
    str, typer.Argument(metavar="OBJECT", help="Mesh file (surface or tetrahedra), or a name of `defgrasp objects`")
]
Scale = Annotated[float, typer.Option(help="Factor on the mesh's coordinates; 0.001 for millimetres")]
EdgeLength = Annotated[float | None, typer.Option(help="Target edge of the tetrahedra made from a surface [m]")]
WallThickness = Annotated[
    float | None, typer.Option(help="Make the surface the outside of a hollow object with walls so thick [m]")
]
ElementOrder = Annotated[
    int | None,
    typer.Option(
        help="1: tetrahedra of four nodes; 2: of ten, which do not lock in bending",
        show_default="2, or as the tetrahedra of a file are",
    ),
]
EdgeRadius = Annotated[float | None, typer.Option(help="Round sharp edges of a surface with this radius [m]")]


def prepared_object(
    text: str,
    scale: float = 1.0,
    edge_length: float | None = None,
    wall_thickness: float | None = None,
    edge_radius: float | None = None,
    element_order: int | None = None,
) -> tuple[str, PreparedMesh, Material]:
    """Return name, tetrahedra and default material of OBJECT.

    Raises:
        NotFoundError: If there is neither such a file nor such an object.
        InvalidMeshError: If it is no solid that can be simulated.
        InvalidOptionsError: If an option has no meaning for an object of the library.
    """
    from defgrasp_ros.mesh.mesh_files import prepare_file
    from defgrasp_ros.objects import find_object

    if _is_name(text):
        found = find_object(text)
        given = {"scale": scale != 1.0, "wall-thickness": wall_thickness, "edge-radius": edge_radius}
        wrong = [name for name, value in given.items() if value]
        if wrong:
            raise InvalidOptionsError(f"--{wrong[0]} belongs to mesh files, but '{text}' is an object of the library")
        mesh = found.mesh(edge_length, element_order)
        return text, PreparedMesh(mesh, None, None, 1, (), ()), found.material.material
    prepared = prepare_file(
        text,
        scale=scale,
        target_edge_length=edge_length,
        wall_thickness=wall_thickness,
        edge_radius=edge_radius,
        element_order=element_order,
    )
    return Path(text).stem, prepared, Material()


def object_surface(text: str, scale: float = 1.0) -> tuple[str, np.ndarray, np.ndarray]:
    """Return name, vertices [m] and triangles of the closed surface of OBJECT; errors as of ``prepared_object``."""
    from defgrasp_ros.mesh.mesh_files import read_surface
    from defgrasp_ros.objects import find_object

    if _is_name(text):
        return text, *find_object(text).surface()
    surface = read_surface(text, scale=scale)
    return Path(text).stem, np.asarray(surface.vertices), np.asarray(surface.faces)


def _is_name(text: str) -> bool:
    """Whether this is the name of an object, not a file: without extension and folder, and there is no such file."""
    return not Path(text).suffix and len(Path(text).parts) == 1 and not Path(text).exists()
