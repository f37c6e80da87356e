"""The contact problem against single contacts with known answers, and its methods against each other."""

import numpy as np
import pytest
import warp as wp

from defgrasp_ros.simulation.coulomb import ContactProblem, CoulombSolver, semismooth_newton
from defgrasp_ros.simulation.dense import DeviceAlgebra, HostAlgebra
from defgrasp_ros.simulation.types import vec3d

FRICTION = 0.5
TOLERANCE = 1e-9


def solve(matrix: np.ndarray, offset: np.ndarray, algebra=None) -> np.ndarray:
    """Forces of one contact problem from a cold start, shape ``(contact, 3)``."""
    contacts = len(offset) // 3
    rho = 0.3 * np.diagonal(matrix).mean()
    device = wp.get_device("cpu")
    zeros = wp.zeros((1, contacts), dtype=vec3d, device=device)
    problem = ContactProblem(
        worlds=wp.array([0], dtype=int, device=device),
        count=wp.array([contacts], dtype=int, device=device),
        friction=FRICTION,
        rho=wp.array([rho], dtype=wp.float64, device=device),
        matrix=wp.array(matrix[None], dtype=wp.float64, device=device),
        inverse=wp.array(np.linalg.inv(matrix + rho * np.eye(3 * contacts))[None], dtype=wp.float64, device=device),
        force=zeros,
        motion=wp.array(offset.reshape(1, contacts, 3), dtype=vec3d, device=device),
        tolerance=wp.array([TOLERANCE], dtype=wp.float64, device=device),
    )
    force, _ = CoulombSolver(1, contacts, device, algebra or HostAlgebra()).solve(problem)
    return force.numpy()[0].copy()


def random_problem(seed: int, contacts: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A compliance with stiff and soft directions, some contacts open, some pressed and dragged."""
    random = np.random.default_rng(seed)
    factor = random.normal(size=(3 * contacts, 3 * contacts))
    matrix = factor @ factor.T / contacts + 0.2 * np.eye(3 * contacts)
    rigid = np.tile(np.eye(3), (contacts, 1))
    dragged = np.tile([-1.0, 60.0, 20.0], contacts)
    return matrix + 50.0 * rigid @ rigid.T, random.normal(size=3 * contacts) + dragged


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        ([0.3, 0.1, 0.0], [0.0, 0.0, 0.0]),
        ([-1.0, 0.2, 0.1], [1.0, -0.2, -0.1]),
        ([-1.0, 2.0, 0.0], [1.0, -0.5, 0.0]),
        ([-1.0, 0.0, -3.0], [1.0, 0.0, 0.5]),
    ],
    ids=["open", "sticking", "sliding", "sliding across"],
)
def test_one_contact(offset, expected):
    """With W = 1: open carries nothing, sticking what closes the gap, sliding mu times the normal force."""
    np.testing.assert_allclose(solve(np.eye(3), np.array(offset)), [expected], atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_laws_hold_in_a_coupled_problem(seed):
    """Every contact is open, sticks inside the cone, or slides against its friction at the cone's edge."""
    matrix, offset = random_problem(seed)
    force = solve(matrix, offset)
    motion = (matrix @ force.ravel() + offset).reshape(-1, 3)
    tangential = np.linalg.norm(force[:, 1:], axis=1)
    slip = np.linalg.norm(motion[:, 1:], axis=1)
    assert (force[:, 0] > -1e-12).all() and (motion[:, 0] > -1e-8).all()
    assert np.abs(force[:, 0] * motion[:, 0]).max() < 1e-8
    assert (tangential <= FRICTION * force[:, 0] + 1e-8).all()
    sliding = (slip > 1e-6) & (force[:, 0] > 1e-6)
    assert sliding.any()
    against = -motion[sliding, 1:] / slip[sliding, None]
    np.testing.assert_allclose(force[sliding, 1:], FRICTION * force[sliding, :1] * against, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_newton_agrees_with_admm(seed):
    """Both methods find the same forces."""
    matrix, offset = random_problem(seed)
    force, residual = semismooth_newton(
        matrix, offset, FRICTION, 3.0 * np.diagonal(matrix).mean(), 0.5 * solve(matrix, offset).ravel(), TOLERANCE
    )
    assert residual < TOLERANCE
    np.testing.assert_allclose(force.reshape(-1, 3), solve(matrix, offset), atol=1e-7)


def test_newton_without_a_direction_is_no_solution(monkeypatch):
    """A singular linear system ends the method with a residual above the tolerance, not with an exception."""

    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(np.linalg, "solve", singular)
    _, residual = semismooth_newton(np.eye(3), np.array([-1.0, 0.0, 0.0]), FRICTION, 0.3, np.zeros(3), TOLERANCE)
    assert residual > TOLERANCE


def test_kernels_for_the_gpu_give_the_same():
    """Products and inverse by kernels agree with BLAS and LAPACK, for sizes that fill no tile."""
    random = np.random.default_rng(7)
    device = wp.get_device("cpu")
    square = random.normal(size=(70, 70))
    square = square @ square.T + np.eye(70)
    rows = random.normal(size=(37, 70))
    matrix = wp.array(square, dtype=wp.float64, device=device)
    out = wp.zeros((37, 70), dtype=wp.float64, device=device)
    DeviceAlgebra().multiply_rows(wp.array(rows, dtype=wp.float64, device=device), matrix, out)
    np.testing.assert_allclose(out.numpy(), rows @ square, rtol=1e-12, atol=1e-10)

    worlds, sizes, shift = np.array([2, 0]), np.array([9, 0, 12]), np.array([0.5, 0.0, 0.1])
    stack = wp.array(
        np.stack([square[:12, :12], square[1:13, 1:13], square[2:14, 2:14]]), dtype=wp.float64, device=device
    )
    inverse = wp.zeros_like(stack)
    DeviceAlgebra().invert(stack, worlds, sizes, shift, inverse)
    for w in worlds:
        n = sizes[w]
        expected = np.linalg.inv(stack.numpy()[w, :n, :n] + shift[w] * np.eye(n))
        np.testing.assert_allclose(inverse.numpy()[w, :n, :n], expected, rtol=1e-9, atol=1e-12)

    problem = random_problem(1)
    np.testing.assert_allclose(solve(*problem, algebra=DeviceAlgebra()), solve(*problem), atol=1e-9)
