"""One entrance to all samplers, by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import EmptyGraspListError, InvalidOptionsError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.sampling.antipodal import DEFAULT_CONE, antipodal_grasps
from defgrasp_ros.sampling.clearance import Fit, HandFit
from defgrasp_ros.sampling.poses import Pose, grid_poses, polar_poses, surface_approach_poses, uniform_poses

ANTIPODAL = "antipodal"
POSE_SAMPLERS = {
    "surface": surface_approach_poses,
    "uniform": uniform_poses,
    "grid": grid_poses,
    "polar": polar_poses,
}
SAMPLERS = (ANTIPODAL, *POSE_SAMPLERS)
"""Names of the samplers."""

MAX_COUNT = 10_000
"""Most grasps that can be asked for."""

MAX_POSES = 2_000
"""Poses tried for each grasp that is asked for, before the search ends."""


def sample_grasps(
    vertices: np.ndarray,
    triangles: np.ndarray,
    gripper: Gripper,
    count: int,
    *,
    sampler: str = ANTIPODAL,
    max_angle: float = DEFAULT_CONE,
    standoff: float = 0.0,
    seed: int = 0,
) -> list[Grasp]:
    """Sample grasps at which the open gripper is free of the object and has it between its pads.

    Args:
        vertices: Positions in the object frame [m], shape ``(vertex, 3)``.
        triangles: Vertex indices, counter-clockwise from outside, shape ``(triangle, 3)``, of a closed surface.
        gripper: Its pads, palm and largest opening.
        count: How many grasps; fewer are returned where so many are not found.
        sampler: One of ``SAMPLERS``.
        max_angle: See ``antipodal_grasps``; without effect on the other samplers.
        standoff: See ``antipodal_grasps``; without effect on the other samplers.
        seed: Of the random numbers; equal seeds give equal grasps.

    Raises:
        InvalidOptionsError: If the sampler is unknown or a number outside its range.
        EmptyGraspListError: If no grasp is found; the text says why the poses that were tried failed.
    """
    if sampler not in SAMPLERS:
        raise InvalidOptionsError(f"sampler '{sampler}' is unknown; known: {', '.join(SAMPLERS)}")
    check = require_in_range
    check(InvalidOptionsError, "count", count, 1, MAX_COUNT)
    check(InvalidOptionsError, "seed", seed, 0, 2**63)
    check(InvalidOptionsError, "max_angle", max_angle, 0.0, np.pi / 2.0, high_open=True, unit="rad")
    check(InvalidOptionsError, "standoff", standoff, gripper.pad_bottom, gripper.pad_top, unit="m")
    vertices, triangles = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if sampler == ANTIPODAL:
        found = antipodal_grasps(vertices, triangles, gripper, count, max_angle=max_angle, standoff=standoff, seed=seed)
        return [candidate.grasp for candidate in found]
    poses = POSE_SAMPLERS[sampler](vertices, triangles, gripper, np.random.default_rng(seed))
    return _fitting(HandFit(vertices, triangles, gripper), poses, count)


def _fitting(fit: HandFit, poses: Iterable[Pose], count: int) -> list[Grasp]:
    """Return grasps at the first ``count`` poses at which the gripper fits."""
    grasps: list[Grasp] = []
    tally: Counter[str] = Counter()
    for tried, (position, rotation) in enumerate(poses):
        if len(grasps) == count or tried == MAX_POSES * count:
            break
        state = fit.check(position, rotation)
        tally[state.value] += 1
        if state is Fit.FREE:
            grasps.append(Grasp(position, Rotation.from_matrix(rotation).as_quat(), id=str(len(grasps))))
    if not grasps:
        reasons = ", ".join(f"{number} x {reason}" for reason, number in tally.most_common())
        raise EmptyGraspListError(f"no grasp was found ({reasons}); try the antipodal sampler or another gripper")
    return grasps
