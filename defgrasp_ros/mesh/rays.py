"""Casts rays at a triangle surface, many at a time, without a search tree.

Two matrix products give the distance of every triangle's centre from every ray; what is within the radius of the
largest triangle is intersected exactly. For the some thousand rays of a sampler this is faster than a tree, whose
building alone takes longer, and needs no library.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PAIRS_AT_ONCE = 2**18
"""Rays times triangles that are looked at together, so many that they stay in the processor's cache."""

SINGLE_PRECISION_SLACK = 1e-5
"""What a squared length computed in single precision may be wrong by, relative to the squared size of the scene."""


@dataclass(frozen=True)
class Hits:
    """Crossings of rays and triangles, sorted by ray and distance.

    Args:
        ray: Index of the ray, shape ``(hit,)``.
        triangle: Index of the triangle, shape ``(hit,)``.
        distance: Along the ray from its origin, in lengths of its direction, positive, shape ``(hit,)``.
    """

    ray: np.ndarray
    triangle: np.ndarray
    distance: np.ndarray


class RayCaster:
    """A surface at which rays are cast.

    Args:
        vertices: Positions [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, shape ``(triangle, 3)``.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        corners = np.asarray(vertices, dtype=np.float64)[triangles]
        self._corner = corners[:, 0]
        self._edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self._middle = corners.mean(axis=(0, 1))  # keeps the digits of a small object far away from the origin
        centres = corners.mean(axis=1)
        squared_radii = (np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)) ** 2
        centres -= self._middle
        squared_distances = np.einsum("ij,ij->i", centres, centres)
        self._squared_size = float((squared_distances + squared_radii).max())
        self._spheres = np.vstack([centres.T, squared_radii - squared_distances]).astype(np.float32)

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """Return all crossings of each ray with the surface.

        Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", J. Graphics Tools 2 (1997).

        Args:
            origins: Where the rays begin [m], shape ``(ray, 3)``; a triangle on which one lies counts only if it is
                hit at a positive distance.
            directions: Unit vectors, shape ``(ray, 3)``.
        """
        block = max(1, PAIRS_AT_ONCE // len(self._corner))
        pairs = [
            self._near(origins[first : first + block], directions[first : first + block], first)
            for first in range(0, len(origins), block)
        ]
        ray, triangle = np.concatenate(pairs, axis=1) if pairs else np.empty((2, 0), dtype=np.int64)
        first_edge, second_edge = self._edges[0][triangle], self._edges[1][triangle]
        direction = directions[ray]
        across = np.cross(direction, second_edge)
        determinant = np.einsum("ij,ij->i", first_edge, across)
        offset = origins[ray] - self._corner[triangle]
        with np.errstate(divide="ignore", invalid="ignore"):  # rays in the plane of a triangle do not cross it
            u = np.einsum("ij,ij->i", offset, across) / determinant
            turned = np.cross(offset, first_edge)
            v = np.einsum("ij,ij->i", direction, turned) / determinant
            distance = np.einsum("ij,ij->i", second_edge, turned) / determinant
            is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
        ray, triangle, distance = ray[is_hit], triangle[is_hit], distance[is_hit]
        order = np.lexsort((distance, ray))
        return Hits(ray[order], triangle[order], distance[order])

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return whether points lie inside, where the surface is closed, shape ``(point,)``.

        A point is inside if a ray from it crosses the surface an odd number of times. Three rays vote, as one that
        runs along an edge counts wrongly.
        """
        votes = np.zeros(len(points), dtype=int)
        for direction in _UNRELATED_DIRECTIONS:
            hits = self.cast(points, np.broadcast_to(direction, points.shape))
            votes += np.bincount(hits.ray, minlength=len(points)) % 2
        return votes >= 2

    def _near(self, origins: np.ndarray, directions: np.ndarray, first: int) -> np.ndarray:
        """Return ray and triangle of each pair in which the ray's line meets the triangle's bounding sphere."""
        starts = origins - self._middle
        # |c - s|^2 - (d . (c - s))^2 <= r^2, with all terms that depend on the triangle in two matrix products.
        near = np.column_stack([2.0 * starts, np.ones(len(starts))]).astype(np.float32) @ self._spheres
        along = directions.astype(np.float32) @ self._spheres[:3]
        along -= np.einsum("ij,ij->i", directions, starts).astype(np.float32)[:, None]
        along *= along
        near += along
        squared_starts = np.einsum("ij,ij->i", starts, starts)
        slack = SINGLE_PRECISION_SLACK * (self._squared_size + squared_starts)
        ray, triangle = np.nonzero(near >= (squared_starts - slack).astype(np.float32)[:, None])
        return np.stack([ray + first, triangle])


_UNRELATED_DIRECTIONS = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
"""Three directions along which no designed shape has its edges."""
