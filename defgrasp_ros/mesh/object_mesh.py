"""From triangles or ready tetrahedra to a mesh that can be simulated, with all checks and mends on the way."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError
from defgrasp_ros.mesh.overlap import enclosed_volume
from defgrasp_ros.mesh.quality import dihedral_angles
from defgrasp_ros.mesh.rounding import with_rounded_edges
from defgrasp_ros.mesh.shell import shell_mesh
from defgrasp_ros.mesh.surface import MENDS, closed_surface, open_surface
from defgrasp_ros.mesh.tet_mesh import TetMesh, made_element_order
from defgrasp_ros.mesh.tetrahedralize import MAX_TETRAHEDRA, tetrahedralize

if TYPE_CHECKING:
    import trimesh

MIN_EXTENT, MAX_EXTENT = 0.001, 2.0
"""Longest side of the bounding box [m] that an object for a gripper can have; outside, the unit is wrong."""

SPECK_FRACTION = 0.01
"""Loose parts below this fraction of the volume are dirt of a scan and are left out."""

OVERLAP_FRACTION = 0.01
"""A surface that overlaps itself by more than this fraction of its volume is united; measuring is no finer."""

POOR_DIHEDRAL_ANGLE = np.radians(2.0)
"""Elements with a smaller angle [rad] are reported: they spoil the solution around them."""

MAX_NODES = 7_000
"""Each dense inverse of the simulation takes 3.5 GB with so many; elements of order 2 reach it first."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PreparedMesh:
    """Tetrahedra ready to be simulated, and what was found on the way to them.

    Args:
        mesh: The tetrahedra.
        triangles: Triangles of the surface as given; None where tetrahedra were given.
        watertight: Whether that surface was closed as given; None where tetrahedra were given.
        components: Bodies that were given, those that were left out included.
        mends: What was mended, in words.
        warnings: What may be wrong with the object, in words.
    """

    mesh: TetMesh
    triangles: int | None
    watertight: bool | None
    components: int
    mends: tuple[str, ...]
    warnings: tuple[str, ...]

    def logged(self) -> TetMesh:
        """Return the mesh; what was mended and what may be wrong goes to the log."""
        for text in (*self.mends, *self.warnings):
            logger.warning(text)
        return self.mesh


def mesh_from_surface(vertices: np.ndarray, triangles: np.ndarray, **options: float | None) -> TetMesh:
    """Return the solid inside a surface; arguments and errors as of ``prepare_surface``."""
    return prepare_surface(vertices, triangles, **options).logged()


def mesh_from_tetrahedra(
    vertices: np.ndarray, tetrahedra: np.ndarray, *, scale: float = 1.0, element_order: int | None = None
) -> TetMesh:
    """Return ready tetrahedra as they are, checked; arguments and errors as of ``prepare_tetrahedra``."""
    return prepare_tetrahedra(vertices, tetrahedra, scale=scale, element_order=element_order).logged()


def prepare_surface(
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    scale: float = 1.0,
    target_edge_length: float | None = None,
    wall_thickness: float | None = None,
    edge_radius: float | None = None,
    element_order: int | None = None,
) -> PreparedMesh:
    """Fill a surface with tetrahedra.

    Args:
        vertices: Positions, in metres after multiplication with ``scale``, shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``; the surface must be closed, unless it is to be the
            outside of a hollow object.
        scale: Factor to metres, e.g. 0.001 for millimetres.
        target_edge_length: Edge length of the tetrahedra [m]; None: for about 1 000 nodes.
        wall_thickness: The surface is the outside of a hollow object with walls so thick [m]; None: it is solid.
        edge_radius: Radius with which sharp edges are rounded [m]; None: they stay sharp.
        element_order: 1 or 2, see :class:`TetMesh`; None: 2.

    Raises:
        InvalidMeshError: If the surface is no solid of plausible size; of a class that says which fault it is.
    """
    order = made_element_order(element_order)
    vertices = _scaled(vertices, scale)
    _require_plausible_size(vertices)
    if wall_thickness is not None:
        surface = open_surface(vertices, triangles)
        watertight = surface.is_watertight
        mends = surface.metadata[MENDS]
        if edge_radius is not None:
            raise InvalidMeshError("edge_radius has no meaning for a hollow object; leave it out")
        mesh = shell_mesh(surface.vertices, surface.faces, wall_thickness, target_edge_length, order)
        warnings: list[str] = []
    else:
        surface = closed_surface(vertices, triangles)
        mends = surface.metadata[MENDS]
        watertight = not any("hole" in mend for mend in mends)
        if edge_radius is not None:
            surface = with_rounded_edges(surface, edge_radius)
        volume, warnings = _united_volume(surface)
        mesh = tetrahedralize(surface.vertices, surface.faces, target_edge_length, order, volume)
    mesh, components = _largest_body(mesh, mends)
    mesh = replace(mesh, element_order=order)
    _check_elements(mesh, warnings)
    return PreparedMesh(mesh, len(triangles), bool(watertight), components, tuple(mends), tuple(warnings))


def prepare_tetrahedra(
    vertices: np.ndarray, tetrahedra: np.ndarray, *, scale: float = 1.0, element_order: int | None = None
) -> PreparedMesh:
    """Check ready tetrahedra; they are taken as they are, but for loose specks.

    Args:
        vertices: Positions, in metres after multiplication with ``scale``, shape ``(vertex, 3)``.
        tetrahedra: Vertex indices, shape ``(tet, 4)``.
        scale: Factor to metres, e.g. 0.001 for millimetres.
        element_order: 1 or 2, see :class:`TetMesh`; None: 1.

    Raises:
        InvalidMeshError: If they are no solid of plausible size.
    """
    if len(tetrahedra) > MAX_TETRAHEDRA:
        raise MeshTooLargeError(
            f"the mesh has {len(tetrahedra)} tetrahedra, more than {MAX_TETRAHEDRA}; mesh it coarser"
        )
    vertices = _scaled(vertices, scale)
    _require_plausible_size(vertices)
    mends: list[str] = []
    warnings: list[str] = []
    mesh, components = _largest_body(TetMesh(vertices, tetrahedra), mends)
    mesh = replace(mesh, element_order=1 if element_order is None else element_order)
    _check_elements(mesh, warnings)
    return PreparedMesh(mesh, None, None, components, tuple(mends), tuple(warnings))


def scaled_surface(vertices: np.ndarray, triangles: np.ndarray, scale: float = 1.0) -> trimesh.Trimesh:
    """Return the closed surface of an object of plausible size [m], mended as in ``closed_surface``.

    Raises:
        InvalidMeshError: As in ``closed_surface``, or if the size shows a wrong unit.
    """
    vertices = _scaled(vertices, scale)
    _require_plausible_size(vertices)
    return closed_surface(vertices, triangles)


def _united_volume(surface: trimesh.Trimesh) -> tuple[float | None, list[str]]:
    """Return the volume [m^3] of a surface that overlaps itself, None of one that does not; and a warning."""
    enclosed = enclosed_volume(surface.vertices, surface.faces)
    if enclosed.overlap <= OVERLAP_FRACTION * enclosed.union:
        return None, []
    share = 100.0 * enclosed.overlap / enclosed.union
    return enclosed.union, [
        f"the surface overlaps itself ({share:.2g} % of the volume): the parts were united, and the volume is known to "
        "about 1 %"
    ]


def _scaled(vertices: np.ndarray, scale: float) -> np.ndarray:
    factor = require_in_range(InvalidMeshError, "scale", scale, 0.0, low_open=True)
    return np.asarray(vertices, dtype=np.float64) * factor


def _require_plausible_size(vertices: np.ndarray) -> None:
    if vertices.shape[1:] != (3,) or len(vertices) == 0 or not np.isfinite(vertices).all():
        return  # the arrays themselves are wrong; whoever reads them says how
    extents = np.ptp(vertices, axis=0)
    if not MIN_EXTENT <= extents.max() <= MAX_EXTENT:
        sides = " x ".join(f"{extent:.3g}" for extent in extents)
        raise InvalidMeshError(
            f"the object measures {sides} m, but its longest side must be between {MIN_EXTENT:g} and {MAX_EXTENT:g} m: "
            "the unit looks wrong; lengths are metres, so give scale=0.001 for a file in millimetres"
        )


def _check_elements(mesh: TetMesh, warnings: list[str]) -> None:
    """Refuse too many elements; warn of poor ones."""
    if len(mesh.tetrahedra) > MAX_TETRAHEDRA:
        raise MeshTooLargeError(
            f"the mesh has {len(mesh.tetrahedra)} tetrahedra, more than {MAX_TETRAHEDRA}; "
            "give a larger target_edge_length"
        )
    if len(mesh.vertices) > MAX_NODES:
        raise MeshTooLargeError(
            f"the mesh has {len(mesh.vertices)} nodes at element_order = {mesh.element_order}, more than {MAX_NODES}; "
            + ("mesh it coarser" if mesh.element_order == 1 else "mesh it coarser, or take element_order = 1")
        )
    angles = dihedral_angles(mesh).min(axis=1)
    poor = angles < POOR_DIHEDRAL_ANGLE
    if poor.any():
        warnings.append(
            f"{poor.sum()} of {len(poor)} tetrahedra are almost flat (smallest dihedral angle "
            f"{np.degrees(angles.min()):.2g} deg): expect slow convergence and wrong stresses there"
        )


def _largest_body(mesh: TetMesh, mends: list[str]) -> tuple[TetMesh, int]:
    """Return the mesh without specks, and the number of bodies; bodies not joined cannot be one object."""
    edges = mesh.tetrahedra[:, [[0, 1], [0, 2], [0, 3]]].reshape(-1, 2)
    size = len(mesh.vertices)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(size, size))
    count, body_of_node = connected_components(graph, directed=False)
    if count == 1:
        return mesh, count
    body = body_of_node[mesh.tetrahedra[:, 0]]
    volumes = np.bincount(body, mesh.volumes)
    rest = 1.0 - volumes.max() / volumes.sum()
    if rest > SPECK_FRACTION:
        listed = ", ".join(f"{volume * 1e6:.3g}" for volume in np.sort(volumes)[:-6:-1])
        raise InvalidMeshError(
            f"the object consists of {count} bodies that are not joined ({listed}{', ...' if count > 5 else ''} cm^3); "
            "a grasped object is one body: unite them, or keep one"
        )
    mends.append(f"left out {count - 1} loose specks, together {100.0 * rest:.2g} % of the volume")
    return TetMesh(mesh.vertices, mesh.tetrahedra[body == volumes.argmax()]), count
