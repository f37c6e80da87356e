"""Tetrahedra from a closed surface, by fTetWild.

Elements are as large as a simulation can use, larger than the triangles of a scan. So the surface is decimated
first (an order of magnitude faster than fTetWild's own simplification), meshed within an envelope around it, and
the boundary then moved so that the solid has the surface's volume. The envelope is narrow for a designed shape of
few triangles, whose edges matter, and wide for a scan, whose roughness is not worth elements.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError, TetrahedralizationError
from defgrasp_ros.mesh.tet_mesh import TetMesh, signed_volumes

if TYPE_CHECKING:
    import trimesh

MAX_TETRAHEDRA = 50_000
"""About 10 000 nodes, for which the simulation's dense inverse takes 3.6 GB."""

DEFAULT_TETRAHEDRA = 3_000
"""Elements aimed at where no edge length is asked for; it becomes 3 000 to 4 500, with 800 to 1 100 nodes."""

MIN_ENVELOPE, MAX_ENVELOPE = 0.02, 0.1
"""How far the boundary may be from the surface, in edge lengths: of few triangles, and of as many as are kept."""

TRIANGLES_PER_FACE = 3
"""Triangles kept by decimation for each boundary face of the mesh to come."""

MIN_TRIANGLES = 100
"""Decimation leaves this many, however large the elements are to be."""

VOLUME_TOLERANCE = 0.05
"""Largest relative difference of volume that moving the boundary may mend; more means that parts are missing."""

TIME_LIMIT = 120
"""Time after which the mesher is stopped [s]; a scan of 16 000 triangles takes 2 s."""

MEMORY_LIMIT = 4 * 2**30
"""Address space of the mesher [B]."""

REGULAR_TRIANGLE = 3.0**0.5 / 4.0
"""Area of the regular triangle of edge length 1."""

REGULAR_TETRAHEDRON = 1.0 / (6.0 * 2.0**0.5)
"""Volume of the regular tetrahedron of edge length 1."""

WORKER = Path(__file__).with_name("tetwild_worker.py")


def tetrahedralize(vertices: np.ndarray, triangles: np.ndarray, target_edge_length: float | None = None) -> TetMesh:
    """Fill a closed surface with tetrahedra; equal input gives equal output.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``, without boundary.
        target_edge_length: Edge length of the elements [m]; None: from the volume, for about 1 000 nodes.

    Raises:
        MeshTooLargeError: If the edge length asks for more elements than ``MAX_TETRAHEDRA``.
        TetrahedralizationError: If the mesher fails, runs into a limit or leaves out parts of the body.
    """
    import trimesh

    surface = trimesh.Trimesh(vertices, triangles, process=False)
    volume = float(surface.volume)
    if target_edge_length is None:
        target_edge_length = _edge_length(volume, DEFAULT_TETRAHEDRA)
    require_in_range(InvalidMeshError, "target_edge_length", target_edge_length, 0.0, low_open=True, unit="m")
    finest = _edge_length(volume, MAX_TETRAHEDRA)
    if target_edge_length < finest:
        raise MeshTooLargeError(
            f"target_edge_length = {target_edge_length:g} m asks for more than {MAX_TETRAHEDRA} tetrahedra; "
            f"give at least {finest:.2g} m"
        )
    faces = surface.area / (REGULAR_TRIANGLE * target_edge_length**2)
    useful_triangles = max(MIN_TRIANGLES, int(TRIANGLES_PER_FACE * faces))
    if len(surface.faces) > useful_triangles:
        surface = surface.simplify_quadric_decimation(face_count=useful_triangles)
    envelope = max(MIN_ENVELOPE, MAX_ENVELOPE * len(surface.faces) / useful_triangles) * target_edge_length
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


def _run_tetwild(surface: trimesh.Trimesh, edge_length: float, envelope: float) -> TetMesh:
    """Mesh the surface in a separate process; lengths in [m]."""
    with tempfile.TemporaryDirectory(prefix="defgrasp_") as directory:
        request, answer = Path(directory, "surface.npz"), Path(directory, "tetrahedra.npz")
        np.savez(
            request,
            vertices=np.asarray(surface.vertices, dtype=np.float64),
            triangles=np.asarray(surface.faces),
            edge_length=edge_length,
            relative_envelope=envelope / np.linalg.norm(surface.extents),
            memory_limit=MEMORY_LIMIT,
            time_limit=TIME_LIMIT,
        )
        # One thread: each thread of a numerics library reserves address space, which is limited.
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
        }
        try:
            process = subprocess.run(
                [sys.executable, str(WORKER), str(request), str(answer)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                timeout=TIME_LIMIT,
                env=environment,
            )
        except subprocess.TimeoutExpired as error:
            raise TetrahedralizationError(
                f"the mesher did not finish in {TIME_LIMIT} s; give a larger target_edge_length or a simpler surface"
            ) from error
        if process.returncode != 0:
            raise TetrahedralizationError(f"the mesher failed: {_reason(process)}")
        with np.load(answer) as arrays:
            if len(arrays["tetrahedra"]) == 0:
                raise TetrahedralizationError("the mesher found no inside: is the surface closed, and not flat?")
            return TetMesh(arrays["vertices"], arrays["tetrahedra"])


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
