"""Which triangles meet an axis-aligned box, exactly."""

from __future__ import annotations

import numpy as np


def triangles_meeting_box(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return whether each triangle has a point inside a box, its boundary left out, shape ``(triangle,)``.

    By the separating axis theorem; Akenine-Moeller, "Fast 3D triangle-box overlap testing", J. Graphics Tools 6
    (2001).

    Args:
        corners: Triangles in the frame of the box [m], shape ``(triangle, 3, 3)``.
        low: Lower corner of the box [m], shape ``(3,)``.
        high: Upper corner [m], shape ``(3,)``.
    """
    if len(corners) == 0:
        return np.zeros(0, dtype=bool)
    meets = ((corners.max(axis=1) > low) & (corners.min(axis=1) < high)).all(axis=1)
    near = np.flatnonzero(meets)
    if len(near) == 0:
        return meets
    half = (high - low) / 2.0
    relative = corners[near] - (low + high) / 2.0
    edges = np.roll(relative, -1, axis=1) - relative
    normal = np.cross(edges[:, 0], edges[:, 1])
    crossed = np.cross(edges[:, :, None], np.eye(3)).reshape(-1, 9, 3)
    axes = np.concatenate([normal[:, None], crossed], axis=1)
    projected = np.einsum("tai,tci->tac", axes, relative)
    reach = np.abs(axes) @ half
    separated = (projected.min(axis=2) >= reach) | (projected.max(axis=2) <= -reach)
    separated &= reach > 1e-9 * half.max() * np.abs(axes).max(axis=(1, 2), keepdims=True)[..., 0]
    meets[near] = ~separated.any(axis=1)
    return meets
