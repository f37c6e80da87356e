"""Makes a surface coarse enough to be sampled quickly."""

from __future__ import annotations

import numpy as np

MAX_TRIANGLES = 20_000
"""A sampler needs no finer surface; collision checks take as long as there are triangles."""


def with_fewer_triangles(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface decimated to ``MAX_TRIANGLES`` where it has more.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``.
    """
    if len(triangles) <= MAX_TRIANGLES:
        return vertices, triangles
    import trimesh

    surface = trimesh.Trimesh(vertices, triangles, process=False)
    coarse = surface.simplify_quadric_decimation(face_count=MAX_TRIANGLES)
    return np.asarray(coarse.vertices), np.asarray(coarse.faces)
