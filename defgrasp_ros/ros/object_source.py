"""The ways in which a request can give the shape of its object."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from defgrasp_ros.mesh.tet_mesh import TetMesh


@dataclass(frozen=True)
class MeshFile:
    """A mesh file that the evaluator reads; it must be on the evaluator's machine.

    Args:
        path: Surface (``.stl``, ``.obj``, ``.ply``, ``.off``) or tetrahedra (``.tet``, ``.msh``).
        scale: Factor on all vertices [-], e.g. 0.001 for a file in millimetres.
        target_edge_length: Edge length of the tetrahedra made from a surface [m]; None: from the object's size.
        element_order: 1 or 2, see :class:`TetMesh`; None: 2 for a surface, tetrahedra as they are.
    """

    path: Path | str
    scale: float = 1.0
    target_edge_length: float | None = None
    element_order: int | None = None


@dataclass(frozen=True)
class MeshData:
    """The content of a mesh file, for an evaluator on another machine.

    Args:
        data: The file's content.
        format: Its suffix without dot, e.g. ``"stl"``.
        scale: Factor on all vertices [-].
        target_edge_length: Edge length of the tetrahedra made from a surface [m]; None: from the object's size.
        element_order: 1 or 2, see :class:`TetMesh`; None: 2 for a surface, tetrahedra as they are.
    """

    data: bytes
    format: str
    scale: float = 1.0
    target_edge_length: float | None = None
    element_order: int | None = None


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed triangle surface that the evaluator fills with tetrahedra.

    Args:
        vertices: Positions in the object frame [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``.
        target_edge_length: Edge length of the tetrahedra [m]; None: from the object's size.
        element_order: 1 or 2, see :class:`TetMesh`; None: 2.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    target_edge_length: float | None = None
    element_order: int | None = None


@dataclass(frozen=True)
class RegisteredObject:
    """An object that the evaluator knows: a registered one, or one of its library.

    Args:
        name: Its name.
        element_order: 1 or 2, see :class:`TetMesh`, for an object of the library; None: 2. Registered objects have
            their own.
    """

    name: str
    element_order: int | None = None


ObjectSource = MeshFile | MeshData | Surface | TetMesh | RegisteredObject
"""The shape of an object, in one of the ways of ``defgrasp_interfaces/msg/ObjectModel``."""
