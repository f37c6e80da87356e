"""Stress and deformation measures on states with known answers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.experiments.metrics import deformation, rigid_motion, von_mises_stress


@pytest.fixture
def cloud() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    return random.normal(size=(60, 3)), random.uniform(0.5, 2.0, 60)


def test_von_mises_of_simple_states():
    """Uniaxial tension gives the tension, pure shear sqrt(3) times the shear, pressure nothing."""
    uniaxial, shear = np.diag([5.0, 0.0, 0.0]), np.zeros((3, 3))
    shear[0, 1] = shear[1, 0] = 2.0
    np.testing.assert_allclose(
        von_mises_stress(np.stack([uniaxial, shear, 7.0 * np.eye(3)])), [5.0, 2.0 * np.sqrt(3.0), 0.0], atol=1e-12
    )


def test_von_mises_does_not_depend_on_the_frame():
    """A rotated stress tensor has the same von Mises stress."""
    random = np.random.default_rng(2)
    stress = random.normal(size=(3, 3))
    stress += stress.T
    rotation = Rotation.random(random_state=3).as_matrix()
    assert von_mises_stress(rotation @ stress @ rotation.T) == pytest.approx(von_mises_stress(stress), rel=1e-12)


def test_rigid_motion_agrees_with_scipy(cloud):
    """The fitted rotation is that of SciPy's independent weighted solution."""
    points, weights = cloud
    moved = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).apply(points) + [1.0, 2.0, 3.0]
    moved += 0.05 * np.random.default_rng(4).normal(size=moved.shape)
    rotation, _ = rigid_motion(points, moved, weights)
    share = weights / weights.sum()
    reference, _ = Rotation.align_vectors(moved - share @ moved, points - share @ points, weights=weights)
    np.testing.assert_allclose(rotation, reference.as_matrix(), atol=1e-9)


def test_rigid_motion_is_no_deformation(cloud):
    """A half turn and a shift leave less than a nanometre."""
    points, weights = cloud
    moved = Rotation.from_rotvec([0.0, np.pi, 0.0]).apply(points) - [5.0, 0.0, 1.0]
    assert deformation(points, moved, weights).max() < 1e-9


def test_deformation_of_one_moved_node(cloud):
    """With nearly all weight on the others, one node's displacement is its own deformation."""
    points, weights = cloud
    moved = points.copy()
    moved[7] += [0.0, 0.3, 0.4]
    weights = weights.copy()
    weights[7] = 1e-9
    assert deformation(points, moved, weights)[7] == pytest.approx(0.5, rel=1e-6)
