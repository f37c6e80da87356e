"""The seven grasp features as functions of a squeezed state.

Definitions after DefGraspSim (Huang et al., RA-L 2022, section V); per-finger values are averaged over the two
fingers, as in the paper. Nothing here simulates.
"""

from __future__ import annotations

import numpy as np

from defgrasp_ros.evaluation import FingerContact, GraspFeatures
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper


def grasp_features(
    grasp: Grasp,
    gripper: Gripper,
    fingers: tuple[FingerContact, FingerContact],
    centroid: np.ndarray,
    opening: float,
    opening_at_contact: float,
    up: np.ndarray,
) -> GraspFeatures:
    """Measure the features of a grasp at its target force.

    Args:
        grasp: Pose of the gripper.
        gripper: Its pads.
        fingers: What left and right finger feel; both touch.
        centroid: Centre of mass of the deformed object [m], shape ``(3,)``.
        opening: Distance of each pad face from the grasp frame's origin [m].
        opening_at_contact: The same where the pads just touch the object that is not squeezed yet [m].
        up: Unit vector against gravity, shape ``(3,)``. All vectors in the same frame as the grasp's pose.
    """
    axis = grasp.rotation[:, 1]
    patches = [finger.centroid for finger in fingers]
    sides = (1.0, -1.0)
    tips = [grasp.position + grasp.rotation @ np.array([0.0, side * opening, gripper.tip]) for side in sides]
    return GraspFeatures(
        contact_patch_distance=_mean(np.linalg.norm(patch - centroid) for patch in patches),
        contact_patch_perpendicular_distance=_mean(_distance_across(patch - centroid, axis) for patch in patches),
        contact_count=_mean(finger.count for finger in fingers),
        edge_distance=_mean(
            _distance_across(patch - tip, grasp.rotation[:, 0]) for patch, tip in zip(patches, tips, strict=True)
        ),
        squeeze_distance=2.0 * (opening_at_contact - opening),
        gripper_separation=2.0 * opening,
        gravity_alignment=float(np.arccos(min(1.0, abs(float(axis @ up))))),
    )


def _distance_across(vector: np.ndarray, axis: np.ndarray) -> float:
    """Length of the part of a vector that is perpendicular to a unit axis."""
    return float(np.linalg.norm(vector - axis * (axis @ vector)))


def _mean(values) -> float:
    return float(np.mean(list(values)))
