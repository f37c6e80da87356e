"""Antipodal grasps: two contacts that face each other, each within the other's friction cone.

As the paper does it (after Eppner, Mousavian and Fox, "A billion ways to grasp", ISRR 2019): a random point of the
surface, a line through it within a cone about its inward normal, the opposite contact where the line leaves the
object, a random roll about the closing axis, both signs of the approach. Other than there, the normal of the second
contact is tested, too, and every wall that the line leaves counts, so that the rim of a cup can be held.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import EmptyGraspListError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.rays import RayCaster
from defgrasp_ros.mesh.surface_geometry import triangle_normals
from defgrasp_ros.sampling.clearance import Fit, HandFit
from defgrasp_ros.sampling.diversity import farthest_first
from defgrasp_ros.sampling.surface_points import in_cone, perpendicular, surface_points

DEFAULT_CONE = 0.1
"""Largest angle between closing axis and contact normals [rad] where none is given: the friction cone of mu = 0.1.
Flat pads turn an object whose faces are more tilted until they lie on them."""

POOL = 3
"""Grasps found for each one that is returned."""

KEPT = 0.5
"""Share of them that is kept, those whose closing axes pass nearest to the middle of the object: far from it the weight
turns the object in the hand. Of these the most different ones are returned."""

MAX_LINES = 400
"""Lines tried for each grasp that is asked for, before the search ends."""

LINES_AT_ONCE = 128
OPENING_MARGIN = 0.002
"""Room that must be left between open pads and object, both sides together [m]."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A pose and its contacts, as ``AntipodalGrasp``; a quaternion is made only of those that are kept."""

    position: np.ndarray
    rotation: np.ndarray
    contacts: np.ndarray
    normals: np.ndarray

    @property
    def angle(self) -> float:
        outward = np.stack([self.rotation[:, 1], -self.rotation[:, 1]])
        cosines = np.einsum("ij,ij->i", outward, self.normals)
        return float(np.arccos(np.clip(cosines.min(), -1.0, 1.0)))

    def axis_distance(self, point: np.ndarray) -> float:
        """Return the distance of a point from the closing axis [m]."""
        return float(np.linalg.norm(np.cross(point - self.contacts[0], self.rotation[:, 1])))

    def named(self, id: str) -> AntipodalGrasp:
        grasp = Grasp(self.position, Rotation.from_matrix(self.rotation).as_quat(), id=id)
        return AntipodalGrasp(grasp, self.contacts, self.normals, self.angle)


@dataclass(frozen=True, eq=False)
class AntipodalGrasp:
    """A grasp and the pair of contacts for which it was made.

    Args:
        grasp: The pose.
        contacts: Where the left and the right pad meet the object [m], shape ``(2, 3)``.
        normals: Outward normals there, shape ``(2, 3)``.
        angle: The larger of the angles between the closing axis and the normals [rad]; 0: a perfect pair.
    """

    grasp: Grasp
    contacts: np.ndarray
    normals: np.ndarray
    angle: float

    @property
    def width(self) -> float:
        """Distance of the two contacts [m]."""
        return float(np.linalg.norm(self.contacts[0] - self.contacts[1]))


def antipodal_grasps(
    vertices: np.ndarray,
    triangles: np.ndarray,
    gripper: Gripper,
    count: int,
    *,
    max_angle: float = DEFAULT_CONE,
    standoff: float = 0.0,
    seed: int = 0,
) -> list[AntipodalGrasp]:
    """Sample antipodal grasps at which the open gripper is free of the object.

    Args:
        vertices: Positions in the object frame [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``, of a closed surface.
        gripper: Its pads, palm and largest opening.
        count: How many grasps; fewer are returned where there are no more.
        max_angle: Largest angle between the closing axis and the contacts' normals [rad], in [0, pi/2).
        standoff: How far the grasp frame stays behind the middle of the contacts, along the approach [m].
        seed: Of the random numbers; equal seeds give equal grasps.

    Returns:
        Grasps in the order of a farthest-point traversal that begins with the one whose closing axis passes nearest
        to the middle of the object: every beginning of the list is spread out.

    Raises:
        EmptyGraspListError: If there is none; the text says why the lines that were tried gave nothing.
    """
    fit = HandFit(vertices, triangles, gripper)
    tally: Counter[str] = Counter()
    pool = []
    for candidate in _candidates(vertices, triangles, gripper, count, max_angle, standoff, seed, tally):
        state = fit.check(candidate.position, candidate.rotation)
        tally[state.value] += 1
        if state is Fit.FREE:
            pool.append(candidate)
            if len(pool) >= POOL * count:
                break
    if not pool:
        reasons = ", ".join(f"{number} x {reason}" for reason, number in tally.most_common())
        raise EmptyGraspListError(
            f"no antipodal grasp was found ({reasons}); allow a larger angle, another standoff or another gripper"
        )
    middle = _centroid(vertices, triangles)
    pool.sort(key=lambda candidate: candidate.axis_distance(middle))
    pool = pool[: max(count, round(KEPT * len(pool)))]
    positions = np.array([candidate.position for candidate in pool])
    rotations = np.array([candidate.rotation for candidate in pool])
    chosen = farthest_first(positions, rotations, count)
    return [pool[index].named(str(number)) for number, index in enumerate(chosen)]


def _candidates(
    vertices: np.ndarray,
    triangles: np.ndarray,
    gripper: Gripper,
    count: int,
    max_angle: float,
    standoff: float,
    seed: int,
    tally: Counter[str],
) -> Iterator[_Candidate]:
    """Yield grasps at pairs of contacts, not yet tested for collision; count the lines that gave none."""
    random = np.random.default_rng(seed)
    rays = RayCaster(vertices, triangles)
    normals = triangle_normals(vertices, triangles)
    max_width = 2.0 * gripper.max_opening - OPENING_MARGIN
    nearest = 1e-6 * float(np.ptp(vertices, axis=0).max())
    cosine = np.cos(max_angle) - 1e-12
    for _ in range(0, MAX_LINES * count, LINES_AT_ONCE):
        starts, on = surface_points(vertices, triangles, LINES_AT_ONCE, random)
        lines = in_cone(-normals[on], max_angle, random)
        hits = rays.cast(starts, lines)
        leaves = np.einsum("ij,ij->i", lines[hits.ray], normals[hits.triangle])
        opposite = (leaves > 0.0) & (hits.distance > nearest)
        facing = opposite & (leaves >= cosine)
        fitting = facing & (hits.distance <= max_width)
        tally["contacts that do not face each other"] += int((opposite & ~facing).sum())
        tally["wider than the gripper opens"] += int((facing & ~fitting).sum())
        chosen = np.flatnonzero(fitting)
        rolls = perpendicular(lines[hits.ray[chosen]], random.uniform(-np.pi, np.pi, len(chosen)))
        for hit, approach in zip(chosen, rolls, strict=True):
            line, start = lines[hits.ray[hit]], starts[hits.ray[hit]]
            end = start + hits.distance[hit] * line
            for sign in (1.0, -1.0):
                axes = np.column_stack([np.cross(line, sign * approach), line, sign * approach])
                yield _Candidate(
                    (start + end) / 2.0 - standoff * sign * approach,
                    axes,
                    np.stack([end, start]),
                    np.stack([normals[hits.triangle[hit]], normals[on[hits.ray[hit]]]]),
                )


def _centroid(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the centre of mass of the solid inside a closed surface [m], shape ``(3,)``."""
    start = vertices.mean(axis=0)
    a, b, c = np.moveaxis(vertices[triangles] - start, 1, 0)
    volumes = np.einsum("ti,ti->t", a, np.cross(b, c))
    return start + volumes @ (a + b + c) / (4.0 * volumes.sum())
