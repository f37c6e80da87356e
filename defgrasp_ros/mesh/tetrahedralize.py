"""Tetrahedra from a closed surface, by fTetWild.

fTetWild keeps the boundary within an envelope around the surface, and needs elements as fine as the triangles to
do so. Triangles of a scan are much finer, those of a designed shape much coarser than the elements a simulation
wants. So the triangles are brought to the size of the elements first, which is also an order of magnitude faster;
and the boundary is moved at the end so that the solid has the surface's volume.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, MeshingTimeoutError, MeshTooLargeError, TetrahedralizationError
from defgrasp_ros.mesh.cache import key_of, load, store
from defgrasp_ros.mesh.limited_process import WorkerError, WorkerTimeoutError, run_worker
from defgrasp_ros.mesh.node_count import with_nodes
from defgrasp_ros.mesh.tet_mesh import DEFAULT_ELEMENT_ORDER, TetMesh, signed_volumes
from defgrasp_ros.mesh.triangle_size import REGULAR_TRIANGLE, with_triangle_size

if TYPE_CHECKING:
    import trimesh

MAX_TETRAHEDRA = 20_000
"""About 4500 nodes, for which each dense inverse of the simulation takes 1.5 GB."""

DEFAULT_TETRAHEDRA, DEFAULT_BOUNDARY_FACES = 3_400, 1_100
"""Size with which the search for a default begins, of elements of order 1: of a compact body, and of a thin one."""

EDGE_BY_ORDER = {1: 1.0, 2: 2.5}
"""Edge lengths with which elements of both orders have about as many nodes, those of order 1 being 1."""

TOO_COARSE = 0.7
"""Factor on an edge length with which the mesher failed, in the search for a default."""

TRIANGLES_PER_FACE = 3
"""Triangles kept for each boundary face of the mesh to come."""

ENVELOPE = 0.1
"""How far the boundary may be from the surface, in edge lengths."""

THIN_ENVELOPE = 0.4
"""The same, in volume / area: a fifth of the thickness of a plate."""

VOLUME_TOLERANCE = 0.1
"""Largest relative difference of volume that moving the boundary may mend; more means that parts are missing."""

ATTEMPTS = 3
"""How often a mesh is tried, each time inserting the triangles in another order."""

TIME_LIMIT = 120.0
"""Time after which the mesher is stopped [s], all attempts together; a scan of 16 000 triangles takes 3 s."""

MEMORY_LIMIT = 4 * 2**30
"""Address space of the mesher [B]."""

REGULAR_TETRAHEDRON = 1.0 / (6.0 * 2.0**0.5)
"""Volume of the regular tetrahedron of edge length 1."""

WORKER = Path(__file__).with_name("tetwild_worker.py")


def tetrahedralize(
    vertices: np.ndarray,
    triangles: np.ndarray,
    target_edge_length: float | None = None,
    element_order: int = DEFAULT_ELEMENT_ORDER,
    volume: float | None = None,
) -> TetMesh:
    """Fill a closed surface with tetrahedra; equal input gives equal output.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``, without boundary.
        target_edge_length: Edge length of the elements [m]; None: one that gives about 1 000 nodes.
        element_order: Of the elements that the mesh is for; order 2 has more nodes to an edge, so edges made for a
            number of nodes are longer.
        volume: Volume of the solid [m^3]; None: what the surface encloses, if it does not overlap itself.

    Raises:
        MeshTooLargeError: If the edge length asks for more elements than ``MAX_TETRAHEDRA``.
        TetrahedralizationError: If the mesher fails, runs into a limit or leaves out parts of the body.
    """
    import trimesh

    surface = trimesh.Trimesh(vertices, triangles, process=False)
    volume = float(volume or surface.volume)
    if target_edge_length is None:
        compact = _edge_length(volume, DEFAULT_TETRAHEDRA)
        thin = (surface.area / (REGULAR_TRIANGLE * DEFAULT_BOUNDARY_FACES)) ** 0.5
        first = EDGE_BY_ORDER[element_order] * max(compact, thin)
        return with_nodes(lambda length: _fill(surface, volume, length), first, element_order, TOO_COARSE)
    check = require_in_range
    check(
        InvalidMeshError, "target_edge_length", target_edge_length, 0.0, surface.extents.max(), low_open=True, unit="m"
    )
    finest = _edge_length(volume, MAX_TETRAHEDRA)
    if target_edge_length < finest:
        raise MeshTooLargeError(
            f"target_edge_length = {target_edge_length:g} m asks for more than {MAX_TETRAHEDRA} tetrahedra; "
            f"give at least {finest:.2g} m"
        )
    return _fill(surface, volume, target_edge_length)


def _fill(surface: trimesh.Trimesh, volume: float, edge_length: float) -> TetMesh:
    """Fill a surface with tetrahedra of an edge length [m] that together have the volume [m^3]."""
    triangles = with_triangle_size(surface, edge_length, TRIANGLES_PER_FACE)
    envelope = min(ENVELOPE * edge_length, THIN_ENVELOPE * volume / surface.area)
    mesh = _run_tetwild(triangles, edge_length, envelope)
    if abs(mesh.volume - volume) > VOLUME_TOLERANCE * volume:
        raise TetrahedralizationError(
            f"the tetrahedra fill {mesh.volume * 1e6:.3g} cm^3, but the surface encloses {volume * 1e6:.3g} cm^3: it "
            f"overlaps itself, or has walls too thin for target_edge_length = {edge_length:.3g} m; unite the "
            "overlapping parts, or give a smaller edge length"
        )
    return _with_volume(mesh, volume)


def _edge_length(volume: float, tetrahedra: int) -> float:
    """Return the edge length [m] with which that many regular tetrahedra have the volume [m^3]."""
    return (volume / (REGULAR_TETRAHEDRON * tetrahedra)) ** (1.0 / 3.0)


def _run_tetwild(surface: trimesh.Trimesh, edge_length: float, envelope: float) -> TetMesh:
    """Mesh the surface in separate processes until one succeeds; lengths in [m]."""
    vertices, triangles = np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces, dtype=np.int64)
    relative_envelope = envelope / np.linalg.norm(surface.extents)
    key = key_of(vertices, triangles, edge_length, relative_envelope)
    if kept := load(key):
        return TetMesh(*kept)
    deadline = time.monotonic() + TIME_LIMIT
    for seed in range(ATTEMPTS):
        request = {
            "vertices": vertices,
            "triangles": triangles,
            "edge_length": edge_length,
            "relative_envelope": relative_envelope,
            "seed": seed,
        }
        remaining = deadline - time.monotonic()
        try:
            answer = run_worker(WORKER, request, time_limit=remaining, memory_limit=MEMORY_LIMIT)
            mesh = TetMesh(answer["vertices"], answer["tetrahedra"])
        except WorkerTimeoutError as error:
            raise MeshingTimeoutError(
                f"the mesher did not finish in {TIME_LIMIT:g} s; give a larger target_edge_length or a simpler surface"
            ) from error
        except (WorkerError, InvalidMeshError) as error:  # the next order of insertion may well succeed
            failure = error
            continue
        store(key, mesh.vertices, mesh.tetrahedra)
        return mesh
    raise TetrahedralizationError(f"the mesher failed: {failure}")


def _with_volume(mesh: TetMesh, volume: float) -> TetMesh:
    """Return the mesh with its boundary moved along the normals until it has the volume [m^3].

    Boundary nodes lie on the surface, so the flat faces between them cut off what bulges: a solid of this
    coarseness is 1 to 2 % too small, and as much too light, without it.
    """
    vertices = mesh.vertices.copy()
    for _ in range(3):  # Newton's method on a cubic; the third step is at rounding
        corners = vertices[mesh.surface_triangles]
        face_areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
        node_areas = np.zeros_like(vertices)
        np.add.at(node_areas, mesh.surface_triangles, face_areas[:, None] / 3.0)
        lengths = np.linalg.norm(node_areas, axis=1, keepdims=True)
        normals = np.divide(node_areas, lengths, out=np.zeros_like(node_areas), where=lengths > 0.0)
        missing = volume - signed_volumes(vertices, mesh.tetrahedra).sum()
        vertices += missing / lengths.sum() * normals
    if signed_volumes(vertices, mesh.tetrahedra).min() <= 0.0:
        raise TetrahedralizationError("the boundary cannot be fitted to the surface; give a smaller target_edge_length")
    return TetMesh(vertices, mesh.tetrahedra)
