"""Rotations spread evenly: random ones, and the grids of the Hopf fibration."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

GRID_SIZES = (72, 576, 4608, 36864)
"""Rotations in the grids; neighbours are about 60, 30, 15 and 7.5 deg apart."""


def rotation_grid(size: int) -> Rotation:
    """Return rotations on a grid that is uniform over SO(3).

    Yershova, Jain, LaValle and Mitchell, "Generating uniform incremental grids on SO(3) using the Hopf fibration",
    IJRR 29 (2010): directions of the HEALPix grid times evenly spaced turns about them.

    Args:
        size: One of ``GRID_SIZES``.
    """
    level = GRID_SIZES.index(size)
    polar, azimuth = healpix_directions(2**level)
    turns = 6 * 2**level
    turn = 2.0 * np.pi * (np.arange(turns) + 0.5) / turns
    angles = [np.repeat(azimuth, turns), np.repeat(polar, turns), np.tile(turn, len(polar))]
    return Rotation.from_euler("ZYZ", np.column_stack(angles))


def healpix_directions(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return polar angle and azimuth [rad] of the ``12 side^2`` pixel centres of the HEALPix grid.

    Pixels have equal areas and lie on ``4 side - 1`` rings; Gorski et al., Astrophysical Journal 622 (2005),
    equations 4 to 9.

    Args:
        side: Pixels along the edge of one of the twelve base pixels.
    """
    heights, azimuths = [], []
    for ring in range(1, 4 * side):
        from_pole = min(ring, 4 * side - ring)
        if from_pole < side:
            height = 1.0 - from_pole**2 / (3.0 * side**2)
            count, shift = 4 * from_pole, 0.5
        else:
            height = abs(4.0 / 3.0 - 2.0 * ring / (3.0 * side))
            count, shift = 4 * side, (ring - side + 1) % 2 / 2.0
        sign = 1.0 if 4.0 / 3.0 - 2.0 * ring / (3.0 * side) >= 0.0 else -1.0
        heights.append(np.full(count, sign * height))
        azimuths.append(2.0 * np.pi * (np.arange(count) + shift) / count)
    return np.arccos(np.concatenate(heights)), np.concatenate(azimuths)
