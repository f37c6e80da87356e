"""Chooses from many grasps the ones that differ most."""

from __future__ import annotations

import numpy as np

MIRRORED = np.array([-1.0, -1.0, 1.0])
"""Half a turn about the approach axis, which gives the same grasp with the fingers exchanged."""


def farthest_first(positions: np.ndarray, rotations: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of ``count`` grasps spread over all of them, the first one first.

    Farthest-point traversal (Gonzalez, Theoretical Computer Science 38, 1985): each next grasp is the one farthest
    from those chosen, so that every beginning of the list is spread out, too. The distance of two grasps is that
    of their positions, relative to the diagonal of the box around all positions, plus their angle relative to
    half a turn.

    Args:
        positions: [m], shape ``(grasp, 3)``.
        rotations: Axes as columns, shape ``(grasp, 3, 3)``.
        count: How many to choose; all if there are no more.
    """
    size = max(float(np.linalg.norm(np.ptp(positions, axis=0))), 1e-12)
    chosen = [0]
    nearest = np.full(len(positions), np.inf)
    while len(chosen) < min(count, len(positions)):
        last = chosen[-1]
        distance = np.linalg.norm(positions - positions[last], axis=1) / size
        products = np.einsum("gij,ij->gj", rotations, rotations[last])
        traces = np.maximum(products.sum(axis=1), products @ MIRRORED)
        distance += np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)) / np.pi
        nearest = np.minimum(nearest, distance)
        nearest[last] = -1.0
        chosen.append(int(nearest.argmax()))
    return np.array(chosen)
