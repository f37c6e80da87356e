"""How much of the friction of a patch is used up, for forces whose answer is known."""

import numpy as np
import pytest

from defgrasp_ros.simulation.gross_slip import GROSS_SLIP_SHARE, mobilised_friction

FRICTION = 0.5


def patch(count: int = 5) -> np.ndarray:
    """Points of a square of 10 mm in the plane y = 3 mm, one at its centre."""
    along = np.linspace(-0.005, 0.005, count)
    x, z = np.meshgrid(along, along)
    return np.stack([x.ravel(), np.full(x.size, 0.003), z.ravel()], axis=1)


def share(positions: np.ndarray, friction_forces: np.ndarray, normal_forces: np.ndarray) -> float:
    normals = np.tile([0.0, 1.0, 0.0], (len(positions), 1))
    return mobilised_friction(positions, normals, normal_forces[:, None] * normals + friction_forces, FRICTION)


@pytest.fixture
def normal_forces() -> np.ndarray:
    return np.random.default_rng(0).uniform(0.5, 2.0, 25)


def opposing(motion: np.ndarray, normal_forces: np.ndarray) -> np.ndarray:
    """Friction at the limit against the motion of each point; none where it does not move."""
    speed = np.linalg.norm(motion, axis=1, keepdims=True)
    return -FRICTION * normal_forces[:, None] * np.divide(motion, speed, out=np.zeros_like(motion), where=speed > 1e-12)


def turn_about(centre: tuple[float, float], positions: np.ndarray) -> np.ndarray:
    offset = positions - [centre[0], 0.0, centre[1]]
    return np.cross([0.0, 1.0, 0.0], offset)


@pytest.mark.parametrize("used", [0.3, 0.9, 1.0])
def test_push_in_one_direction(normal_forces, used):
    """Forces of the same share everywhere use up that share."""
    forces = used * opposing(np.tile([0.6, 0.0, -0.8], (25, 1)), normal_forces)
    assert share(patch(), forces, normal_forces) == pytest.approx(used, abs=1e-6)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.005, 0.005), (0.0013, 0.004), (0.05, 0.0)])
def test_turn_about_any_point_is_gross_slip(normal_forces, centre):
    """All points turn about one, which may be a contact point that does not slide: nothing is left."""
    forces = opposing(turn_about(centre, patch()), normal_forces)
    assert share(patch(), forces, normal_forces) > 0.999 > GROSS_SLIP_SHARE
    assert share(patch(), 0.9 * forces, normal_forces) == pytest.approx(0.9, abs=2e-3)


def test_spreading_is_no_slip(normal_forces):
    """A soft object that spreads under the pad has all its points at the limit, and yet does not slide away."""
    ring = patch()[np.linalg.norm(patch()[:, [0, 2]], axis=1) > 1e-6]
    even = np.ones(len(ring))
    assert share(ring, opposing(ring * [1.0, 0.0, 1.0], even), even) < 1e-6


def test_partial_slip_is_what_the_load_says(normal_forces):
    """Only the load counts, not how it is spread: half the points at the limit and half without are one half."""
    forces = opposing(np.tile([1.0, 0.0, 0.0], (25, 1)), np.ones(25))
    forces[np.arange(25) % 2 == 1] = 0.0
    assert share(patch(), forces, np.ones(25)) == pytest.approx(13 / 25, abs=1e-3)


def test_no_load_and_one_point():
    """Without contact nothing is used up; a single point slides when it is at its limit."""
    nothing = np.empty((0, 3))
    assert mobilised_friction(nothing, nothing, nothing, FRICTION) == 0.0
    assert share(patch()[:1], np.array([[FRICTION, 0.0, 0.0]]), np.ones(1)) == pytest.approx(1.0, abs=1e-6)


def test_agrees_with_a_search_over_all_motions(normal_forces):
    """Random forces within the cones: no motion of a fine grid uses up more, and the best uses up nearly as much."""
    random, positions = np.random.default_rng(3), patch()
    angle, used = random.uniform(0.0, 1.5, 25), random.uniform(0.0, 1.0, 25)
    direction = np.stack([np.cos(angle), np.zeros(25), np.sin(angle)], axis=1)
    forces = FRICTION * (used * normal_forces)[:, None] * direction
    best = 0.0
    for heading in np.linspace(0.0, 2.0 * np.pi, 181):
        for turning in np.linspace(-500.0, 500.0, 201):
            motion = [np.cos(heading), 0.0, np.sin(heading)] + turning * turn_about((0.0, 0.0), positions)
            power = np.einsum("ij,ij->", forces, motion)
            best = max(best, power / (FRICTION * normal_forces @ np.linalg.norm(motion, axis=1)))
    assert share(positions, forces, normal_forces) == pytest.approx(best, abs=2e-3)
