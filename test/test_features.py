"""The seven features of a squeezed state made by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.evaluation import FingerContact
from defgrasp_ros.experiments.features import grasp_features
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper

UP = np.array([0.0, 0.0, 1.0])


def finger(name: str, positions: list, normal: list) -> FingerContact:
    positions = np.array(positions, dtype=float)
    normals = np.tile(np.array(normal, dtype=float), (len(positions), 1))
    return FingerContact(name, positions, normals, 0.5 * normals)


def test_features_of_a_state_made_by_hand():
    """A gripper from above, patches 2 mm below and 1 mm beside its origin, centroid 10 mm below it."""
    gripper = load_gripper()
    grasp = Grasp(np.array([0.1, 0.0, 0.05]), Rotation.from_euler("x", np.pi).as_quat())
    half = 0.012
    # Approach is -z, so the left finger (+y of the grasp frame) is on the -y side of the object frame.
    left = finger("left_finger", [[0.1005, -half, 0.048], [0.1015, -half, 0.048]], [0, 1, 0])
    right = finger("right_finger", [[0.101, half, 0.048]], [0, -1, 0])
    features = grasp_features(grasp, gripper, (left, right), np.array([0.1, 0.0, 0.04]), half, 0.015, UP)
    assert features.contact_count == 1.5
    assert features.contact_patch_distance == pytest.approx(np.sqrt(0.001**2 + half**2 + 0.008**2))
    assert features.contact_patch_perpendicular_distance == pytest.approx(np.sqrt(0.001**2 + 0.008**2))
    assert features.edge_distance == pytest.approx(gripper.tip - 0.002)
    assert features.squeeze_distance == pytest.approx(0.006)
    assert features.gripper_separation == pytest.approx(0.024)
    assert features.gravity_alignment == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("tilt", [0.0, 0.4, np.pi / 2, 2.0, np.pi])
def test_gravity_alignment_is_folded(tilt):
    """The two pad normals are opposite, so the angle lies between 0 and 90 degrees."""
    grasp = Grasp(np.zeros(3), Rotation.from_euler("x", tilt).as_quat())
    patch = finger("left_finger", [[0.0, 0.0, 0.0]], [0, 1, 0])
    features = grasp_features(grasp, load_gripper(), (patch, patch), np.zeros(3), 0.01, 0.01, UP)
    assert features.gravity_alignment == pytest.approx(abs(np.pi / 2 - min(tilt, np.pi - tilt) % np.pi), abs=1e-9)
