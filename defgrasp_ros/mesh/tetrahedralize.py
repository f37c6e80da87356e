"""Tetrahedra from a closed surface, by fTetWild.

fTetWild keeps the boundary within an envelope around the surface, and needs elements as fine as the triangles to
do so. Triangles of a scan are much finer, those of a designed shape much coarser than the elements a simulation
wants. So the triangles are brought to the size of the elements first, which is also an order of magnitude faster;
and the boundary is moved at the end so that the solid has the surface's volume.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError, TetrahedralizationError
from defgrasp_ros.mesh.tet_mesh import TetMesh, signed_volumes

if TYPE_CHECKING:
    import trimesh

MAX_TETRAHEDRA = 20_000
"""About 4500 nodes, for which each dense inverse of the simulation takes 1.5 GB."""

DEFAULT_TETRAHEDRA, DEFAULT_BOUNDARY_FACES = 3_000, 2_000
"""Size aimed at where no edge length is asked for: of a compact body, and of a thin one; about 1 000 nodes."""

EDGE_BY_ORDER = {1: 1.0, 2: 2.5}
"""Edge lengths with which elements of both orders have about as many nodes, those of order 1 being 1."""

TRIANGLES_PER_FACE = 3
"""Triangles kept for each boundary face of the mesh to come."""

MIN_TRIANGLES = 100
"""As many triangles are kept however large the elements are to be."""

LONGEST_TRIANGLE_EDGE = 4.0 / 3.0
"""In edge lengths of the elements; the length at which fTetWild splits edges too."""

ENVELOPE = 0.1
"""How far the boundary may be from the surface, in edge lengths."""

THIN_ENVELOPE = 0.2
"""The same, in volume / area: a tenth of the thickness of a plate."""

VOLUME_TOLERANCE = 0.1
"""Largest relative difference of volume that moving the boundary may mend; more means that parts are missing."""

ATTEMPTS = 3
"""How often a mesh is tried, each time inserting the triangles in another order."""

TIME_LIMIT = 120.0
"""Time after which the mesher is stopped [s], all attempts together; a scan of 16 000 triangles takes 3 s."""

MEMORY_LIMIT = 4 * 2**30
"""Address space of the mesher [B]."""

REGULAR_TRIANGLE = 3.0**0.5 / 4.0
"""Area of the regular triangle of edge length 1."""

REGULAR_TETRAHEDRON = 1.0 / (6.0 * 2.0**0.5)
"""Volume of the regular tetrahedron of edge length 1."""

WORKER = Path(__file__).with_name("tetwild_worker.py")


def tetrahedralize(
    vertices: np.ndarray, triangles: np.ndarray, target_edge_length: float | None = None, element_order: int = 1
) -> TetMesh:
    """Fill a closed surface with tetrahedra; equal input gives equal output.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``, without boundary.
        target_edge_length: Edge length of the elements [m]; None: from the volume, for about 1 000 nodes.
        element_order: Of the elements that the mesh is for; order 2 has more nodes to an edge, so the edges are longer.

    Raises:
        MeshTooLargeError: If the edge length asks for more elements than ``MAX_TETRAHEDRA``.
        TetrahedralizationError: If the mesher fails, runs into a limit or leaves out parts of the body.
    """
    import trimesh

    surface = trimesh.Trimesh(vertices, triangles, process=False)
    volume, area = float(surface.volume), float(surface.area)
    if target_edge_length is None:
        edge_length = max(
            _edge_length(volume, DEFAULT_TETRAHEDRA), (area / (REGULAR_TRIANGLE * DEFAULT_BOUNDARY_FACES)) ** 0.5
        )
        target_edge_length = EDGE_BY_ORDER[element_order] * edge_length
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
    surface = _with_triangle_size(surface, target_edge_length)
    envelope = min(ENVELOPE * target_edge_length, THIN_ENVELOPE * volume / area)
    mesh = _run_tetwild(surface, target_edge_length, envelope)
    if abs(mesh.volume - volume) > VOLUME_TOLERANCE * volume:
        raise TetrahedralizationError(
            f"the tetrahedra fill {mesh.volume * 1e6:.3g} cm^3, but the surface encloses {volume * 1e6:.3g} cm^3: it "
            f"overlaps itself, or has walls too thin for target_edge_length = {target_edge_length:.3g} m; unite the "
            "overlapping parts, or give a smaller edge length"
        )
    return _with_volume(mesh, volume)


def _edge_length(volume: float, tetrahedra: int) -> float:
    """Return the edge length [m] with which that many regular tetrahedra have the volume [m^3]."""
    return (volume / (REGULAR_TETRAHEDRON * tetrahedra)) ** (1.0 / 3.0)


def _with_triangle_size(surface: trimesh.Trimesh, edge_length: float) -> trimesh.Trimesh:
    """Return the surface with triangles that suit elements of that edge length [m]."""
    import trimesh

    faces = surface.area / (REGULAR_TRIANGLE * edge_length**2)
    count = max(MIN_TRIANGLES, int(TRIANGLES_PER_FACE * faces))
    if len(surface.faces) > count:
        return surface.simplify_quadric_decimation(face_count=count)
    split = _split_long_edges(surface.vertices, surface.faces, LONGEST_TRIANGLE_EDGE * edge_length, count)
    return trimesh.Trimesh(*split, process=False)


def _split_long_edges(
    vertices: np.ndarray, triangles: np.ndarray, max_length: float, max_triangles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Halve edges until none is too long or there are enough triangles; the surface keeps its shape.

    An edge is split where it is the longest one of both of its triangles, so that they stay joined and well shaped.
    """
    while len(triangles) < max_triangles:
        pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        edges, edge_of_side = np.unique(pairs, axis=0, return_inverse=True)
        edge_of_side = edge_of_side.reshape(-1, 3)
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        rank = np.empty(len(edges), dtype=int)
        rank[np.argsort(lengths, kind="stable")] = np.arange(len(edges))  # no two edges are equally long
        longest_side = rank[edge_of_side].argmax(axis=1)
        longest = np.take_along_axis(edge_of_side, longest_side[:, None], axis=1)[:, 0]
        is_longest_of_all = np.bincount(longest, minlength=len(edges)) == np.bincount(edge_of_side.ravel())
        to_split = is_longest_of_all & (lengths > max_length)
        if not to_split.any():
            break
        middle = np.cumsum(to_split) - 1 + len(vertices)
        vertices = np.concatenate([vertices, vertices[edges[to_split]].mean(axis=1)])
        halved = to_split[longest]
        sides = (longest_side[halved, None] + np.arange(3)) % 3
        start, end, apex = np.take_along_axis(triangles[halved], sides, axis=1).T
        new = middle[longest[halved]]
        halves = [np.column_stack([start, new, apex]), np.column_stack([new, end, apex])]
        triangles = np.concatenate([triangles[~halved], *halves])
    return vertices, triangles


def _run_tetwild(surface: trimesh.Trimesh, edge_length: float, envelope: float) -> TetMesh:
    """Mesh the surface in separate processes until one succeeds; lengths in [m]."""
    deadline = time.monotonic() + TIME_LIMIT
    for seed in range(ATTEMPTS):
        try:
            return TetMesh(*_run_worker(surface, edge_length, envelope, seed, deadline - time.monotonic()))
        except subprocess.TimeoutExpired as error:
            raise TetrahedralizationError(
                f"the mesher did not finish in {TIME_LIMIT:g} s; give a larger target_edge_length or a simpler surface"
            ) from error
        except InvalidMeshError as error:  # the next order of insertion may well succeed
            failure = error
    raise TetrahedralizationError(f"the mesher failed: {failure}")


def _run_worker(
    surface: trimesh.Trimesh, edge_length: float, envelope: float, seed: int, time_limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Run the mesher once; return vertices [m] and tetrahedra."""
    with tempfile.TemporaryDirectory(prefix="defgrasp_") as directory:
        request, answer = Path(directory, "surface.npz"), Path(directory, "tetrahedra.npz")
        np.savez(
            request,
            vertices=np.asarray(surface.vertices, dtype=np.float64),
            triangles=np.asarray(surface.faces),
            edge_length=edge_length,
            relative_envelope=envelope / np.linalg.norm(surface.extents),
            seed=seed,
            memory_limit=MEMORY_LIMIT,
            time_limit=math.ceil(TIME_LIMIT),
        )
        # One thread: each thread of a numerics library reserves address space, which is limited.
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(os.path.abspath, filter(None, sys.path))),
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
        }
        process = subprocess.run(
            [sys.executable, str(WORKER), str(request), str(answer)],
            cwd=directory,  # fTetWild leaves files of its own there
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            timeout=max(time_limit, 0.0),
            env=environment,
        )
        if process.returncode != 0:
            raise TetrahedralizationError(_reason(process))
        with np.load(answer) as arrays:
            return arrays["vertices"], arrays["tetrahedra"]


def _reason(process: subprocess.CompletedProcess) -> str:
    """Return why the mesher's process ended: its signal, or the last line it wrote."""
    if process.returncode < 0:
        return f"ended by {signal.Signals(-process.returncode).name}"
    lines = process.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit status {process.returncode}"


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
