"""The contact problem against single contacts with known answers, and its methods against each other."""

import numpy as np
import pytest
import warp as wp

from defgrasp_ros.simulation import kernels_coulomb
from defgrasp_ros.simulation.coulomb import (
    ContactProblem,
    project_on_cone,
    semismooth_newton,
    solve_contacts,
    with_de_saxce,
)
from defgrasp_ros.simulation.types import vec3d

FRICTION = 0.5
TOLERANCE = 1e-9


def problem_of(matrix: np.ndarray, offset: np.ndarray) -> ContactProblem:
    """Return a problem whose scale fits its matrix."""
    return ContactProblem(matrix, offset, FRICTION, 0.3 * np.diagonal(matrix).mean())


def solve(matrix: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Forces of one contact problem from a cold start, shape ``(contact, 3)``."""
    return solve_contacts(problem_of(matrix, offset), np.zeros(len(offset)), TOLERANCE)[0].reshape(-1, 3)


def admm(problem: ContactProblem, iterations: int = 3000) -> np.ndarray:
    """An independent method: over-relaxed ADMM with the scaled dual u, whose De Saxce shift s is taken from the dual.

    x = (W + rho)^-1 (rho (z - u) - q - s),   s = (mu rho |u_t|, 0, 0),   z = Proj_K(x' + u),   u += x' - z
    """
    rho, friction = problem.rho, problem.friction
    inverse = np.linalg.inv(problem.matrix + rho * np.eye(len(problem.offset)))
    z = np.zeros((len(problem.offset) // 3, 3))
    dual = -with_de_saxce(problem.offset.reshape(-1, 3), friction) / rho
    for _ in range(iterations):
        right_side = rho * (z - dual)
        right_side[:, 0] -= friction * rho * np.hypot(dual[:, 1], dual[:, 2])
        x = (inverse @ (right_side.ravel() - problem.offset)).reshape(-1, 3)
        relaxed = 1.5 * x - 0.5 * z
        z = project_on_cone(relaxed + dual, friction)
        dual = dual + relaxed - z
    return z.ravel()


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
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_newton_agrees_with_admm(seed, scale):
    """Both methods find the same forces, Newton's with any scaling that works."""
    problem = problem_of(*random_problem(seed))
    start = np.zeros(len(problem.offset))
    by_admm = admm(problem)
    assert problem.residual(by_admm, problem.motion(by_admm)) < TOLERANCE
    force, residual = semismooth_newton(problem, scale * problem.rho, start, TOLERANCE)
    assert residual < TOLERANCE
    np.testing.assert_allclose(force, by_admm, atol=1e-7)


def test_points_that_depend_on_each_other():
    """Contacts given twice carry together what one of them carries alone."""
    matrix, offset = random_problem(0)
    once = solve(matrix, offset)
    twice = solve(np.tile(matrix, (2, 2)), np.tile(offset, 2))
    np.testing.assert_allclose(twice[: len(once)] + twice[len(once) :], once, atol=1e-6)


def test_no_direction_is_no_solution(monkeypatch):
    """Singular linear systems end the method with a residual above the tolerance, not with an exception."""

    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    matrix, offset = random_problem(0)
    problem = problem_of(matrix, offset)
    monkeypatch.setattr(np.linalg, "solve", singular)
    force, hard = solve_contacts(problem, np.zeros(len(offset)), TOLERANCE)
    assert hard and problem.residual(force, problem.motion(force)) > TOLERANCE


def test_kernel_and_host_judge_alike():
    """The residual that ends a step and the one that ends Newton's method are the same function."""
    problem = problem_of(*random_problem(2))
    random = np.random.default_rng(5)
    force, motion = random.normal(size=(2, len(problem.offset)))
    count = len(force) // 3
    arrays = [wp.array(a.reshape(1, count, 3), dtype=vec3d, device="cpu") for a in (force, motion)]
    out = wp.zeros(1, dtype=wp.float64, device="cpu")
    inputs = [wp.array([count], dtype=int), wp.array([0], dtype=int), FRICTION, wp.array([problem.rho]), *arrays]
    wp.launch(kernels_coulomb.contact_residual, dim=1, inputs=inputs, outputs=[out], device="cpu")
    assert out.numpy()[0] == pytest.approx(problem.residual(force, motion), rel=1e-12)


def test_no_contact_at_all():
    """Nothing to solve is solved at once."""
    force, hard = solve_contacts(ContactProblem(np.empty((0, 0)), np.empty(0), FRICTION, 1.0), np.empty(0), TOLERANCE)
    assert len(force) == 0 and not hard
