"""Poses that do not look for a pair of contacts: the other samplers of the original.

Each yields positions and rotations of the grasp frame without end, or until its lattice is exhausted; whoever asks
takes those at which the gripper fits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.surface_geometry import triangle_normals
from defgrasp_ros.sampling.clearance import closing_region
from defgrasp_ros.sampling.rotations import GRID_SIZES, rotation_grid
from defgrasp_ros.sampling.surface_points import in_cone, perpendicular, surface_points

Pose = tuple[np.ndarray, np.ndarray]
"""Position [m], shape ``(3,)``, and rotation with the axes as columns, shape ``(3, 3)``, in the object frame."""

AT_ONCE = 256
GRID_STEP = 0.02
"""Spacing of the lattice of positions [m]."""
POLAR_STEP = 0.02
"""Spacing of the positions along a ray from the centre of the object [m]."""
POLAR_TILT = np.radians(30.0)
"""Largest angle between approach and direction to the centre [rad]."""


def surface_approach_poses(
    vertices: np.ndarray, triangles: np.ndarray, gripper: Gripper, random: np.random.Generator
) -> Iterator[Pose]:
    """Approach a random surface point along its normal, with random roll, so far that it is between the pads."""
    normals = triangle_normals(vertices, triangles)
    while True:
        points, on = surface_points(vertices, triangles, AT_ONCE, random)
        depths = random.uniform(gripper.pad_bottom, gripper.pad_top, AT_ONCE)
        closing = perpendicular(-normals[on], random.uniform(-np.pi, np.pi, AT_ONCE))
        for point, normal, axis, depth in zip(points, normals[on], closing, depths, strict=True):
            yield point + depth * normal, np.column_stack([np.cross(axis, -normal), axis, -normal])


def uniform_poses(
    vertices: np.ndarray, triangles: np.ndarray, gripper: Gripper, random: np.random.Generator
) -> Iterator[Pose]:
    """Uniform over positions from which the pads reach the object's bounding box, and over all rotations."""
    low, high = _reachable_box(vertices, gripper)
    while True:
        positions = random.uniform(low, high, (AT_ONCE, 3))
        yield from zip(positions, Rotation.random(AT_ONCE, rng=random).as_matrix(), strict=True)


def grid_poses(
    vertices: np.ndarray, triangles: np.ndarray, gripper: Gripper, random: np.random.Generator
) -> Iterator[Pose]:
    """Every position of a lattice with every rotation of the coarsest grid, each once, in random order."""
    low, high = _reachable_box(vertices, gripper)
    axes = [np.arange(first, last, GRID_STEP) for first, last in zip(low, high, strict=True)]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    rotations = rotation_grid(GRID_SIZES[0]).as_matrix()
    for index in random.permutation(len(positions) * len(rotations)):
        place, turn = divmod(int(index), len(rotations))
        yield positions[place], rotations[turn]


def polar_poses(
    vertices: np.ndarray, triangles: np.ndarray, gripper: Gripper, random: np.random.Generator
) -> Iterator[Pose]:
    """On random rays from the centre of the object, at steps along them, looking roughly back at the centre."""
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    reach = np.linalg.norm(vertices - centre, axis=1).max() + _reach(gripper)
    distances = np.arange(0.0, reach, POLAR_STEP)
    while True:
        outward = random.normal(size=(AT_ONCE, 3))
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        approach = in_cone(-outward, POLAR_TILT, random)
        closing = perpendicular(approach, random.uniform(-np.pi, np.pi, AT_ONCE))
        places = random.choice(distances, AT_ONCE)
        for ray, forward, axis, distance in zip(outward, approach, closing, places, strict=True):
            yield centre + distance * ray, np.column_stack([np.cross(axis, forward), axis, forward])


def _reach(gripper: Gripper) -> float:
    """Return how far from the grasp frame's origin the region between the open pads goes [m]."""
    return float(np.linalg.norm(np.abs(closing_region(gripper)).max(axis=0)))


def _reachable_box(vertices: np.ndarray, gripper: Gripper) -> tuple[np.ndarray, np.ndarray]:
    return vertices.min(axis=0) - _reach(gripper), vertices.max(axis=0) + _reach(gripper)
