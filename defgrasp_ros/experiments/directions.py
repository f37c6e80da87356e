"""The 16 directions of the reorientation and acceleration experiments."""

from __future__ import annotations

import numpy as np

DIRECTION_COUNT = 16


def sphere_directions() -> np.ndarray:
    """Return 16 unit vectors on equal-area rings of the sphere (Deserno 2004), object frame, shape ``(16, 3)``.

    4 + 8 + 4 vectors at polar angles of 30, 90 and 150 degrees. The set is closed under negation. Order and azimuths
    are DefGraspSim's.
    """
    area = 4.0 * np.pi / DIRECTION_COUNT
    rings = int(np.pi / np.sqrt(area))
    spacing = np.pi / rings
    directions = []
    for ring in range(rings):
        polar = (ring + 0.5) * spacing
        count = int(2.0 * np.pi * np.sin(polar) * spacing / area)
        azimuth = 2.0 * np.pi * np.arange(count) / count
        x, y, z = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.full(count, np.cos(polar))
        directions.append(np.stack([y, -x, z], axis=1))
    return np.concatenate(directions)
