"""The contact solver against single contacts with known answers, and against an independent method."""

import numpy as np
import pytest
import warp as wp

from defgrasp_ros.simulation import kernels_coulomb as coulomb
from defgrasp_ros.simulation.contact_solver import ContactSolver
from defgrasp_ros.simulation.kernels_block_matrix import (
    block_of_symmetric,
    eliminate_symmetric,
    factorise,
    multiply_symmetric,
    scale_by_pivots,
    solve_factorised,
    substitute_backwards,
    substitute_forwards,
)
from defgrasp_ros.simulation.kernels_contact_solver import ATTEMPTS
from defgrasp_ros.simulation.kernels_interior_point import InteriorPointBuffers, interior_point
from defgrasp_ros.simulation.rows import RowList
from defgrasp_ros.simulation.types import mat33d, vec3d

FRICTION = 0.5
TOLERANCE = 1e-9
ONE_ROW = RowList(1, wp.get_device("cpu")).assign(np.array([0]))


def blocks(matrix: np.ndarray) -> np.ndarray:
    """Return a square matrix as 3 x 3 blocks, shape ``(i, j, 3, 3)``."""
    count = len(matrix) // 3
    return np.ascontiguousarray(matrix.reshape(count, 3, count, 3).transpose(0, 2, 1, 3))


def upper_half(matrix: np.ndarray) -> np.ndarray:
    """Return the upper half of a symmetric matrix by rows of 3 x 3 blocks, shape ``(place, 3, 3)``."""
    return blocks(matrix)[np.triu_indices(len(matrix) // 3)]


def project_on_cone(v: np.ndarray, friction: float = FRICTION) -> np.ndarray:
    """Return the points of the Coulomb cone closest to v, shape ``(contact, 3)``."""
    tangential = np.hypot(v[:, 1], v[:, 2])
    inside = tangential <= friction * v[:, 0]
    normal = np.maximum((v[:, 0] + friction * tangential) / (1.0 + friction**2), 0.0)
    share = np.where(inside, 1.0, friction * normal / np.maximum(tangential, 1e-300))
    return np.stack([np.where(inside, v[:, 0], normal), share * v[:, 1], share * v[:, 2]], axis=1)


def scale_of(matrix: np.ndarray) -> float:
    """Return a scale of the natural map that fits a matrix [m/N]."""
    return 0.3 * np.diagonal(matrix).mean()


def residual(matrix: np.ndarray, offset: np.ndarray, force: np.ndarray, friction: float = FRICTION) -> float:
    """Return the natural map's residual, written down a second time; forces have shape ``(contact, 3)``."""
    motion = (matrix @ force.ravel() + offset).reshape(-1, 3)
    motion[:, 0] += friction * np.hypot(motion[:, 1], motion[:, 2])
    return np.linalg.norm(force - project_on_cone(force - motion / scale_of(matrix), friction), axis=1).max(initial=0.0)


def problem_of(
    matrix: np.ndarray, offset: np.ndarray, friction: float = FRICTION, start: np.ndarray | None = None
) -> coulomb.ContactProblems:
    """One problem as the kernels take it; from no force by default."""
    count, problems = len(offset) // 3, coulomb.ContactProblems()
    force = np.zeros_like(offset) if start is None else start.ravel()
    problems.worlds = wp.array([0], dtype=int, device="cpu")
    problems.count = wp.array([count], dtype=int, device="cpu")
    problems.matrix = wp.array(upper_half(matrix)[None], dtype=mat33d, device="cpu")
    problems.force, problems.motion = (
        wp.array(a.reshape(1, count, 3), dtype=vec3d, device="cpu") for a in (force, matrix @ force + offset)
    )
    problems.friction = friction
    problems.rho = wp.array([scale_of(matrix) if count else 1.0], dtype=wp.float64, device="cpu")
    return problems


def solve_with_attempts(
    matrix: np.ndarray,
    offset: np.ndarray,
    friction: float = FRICTION,
    start: np.ndarray | None = None,
    solver: ContactSolver | None = None,
) -> tuple[np.ndarray, int]:
    """Forces of one problem, shape ``(contact, 3)``, and the number of methods it took; from no force by default."""
    solver = solver or ContactSolver(1, len(offset) // 3, wp.get_device("cpu"))
    tolerance = wp.array([TOLERANCE], dtype=wp.float64, device="cpu")
    solver.solve(ONE_ROW, problem_of(matrix, offset, friction, start), tolerance)
    return solver.force.numpy()[0].copy(), int(solver.attempts.numpy()[0])


def solve(matrix: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Forces of one contact problem from a cold start, shape ``(contact, 3)``."""
    return solve_with_attempts(matrix, offset)[0]


def admm(matrix: np.ndarray, offset: np.ndarray, iterations: int = 3000) -> np.ndarray:
    """An independent method: over-relaxed ADMM with the scaled dual u, whose De Saxce shift s is taken from the dual.

    x = (W + rho)^-1 (rho (z - u) - q - s),   s = (mu rho |u_t|, 0, 0),   z = Proj_K(x' + u),   u += x' - z
    """
    rho = scale_of(matrix)
    inverse = np.linalg.inv(matrix + rho * np.eye(len(offset)))
    z = np.zeros((len(offset) // 3, 3))
    dual = -offset.reshape(-1, 3) / rho
    dual[:, 0] -= FRICTION * np.hypot(dual[:, 1], dual[:, 2])
    for _ in range(iterations):
        right_side = rho * (z - dual)
        right_side[:, 0] -= FRICTION * rho * np.hypot(dual[:, 1], dual[:, 2])
        x = (inverse @ (right_side.ravel() - offset)).reshape(-1, 3)
        relaxed = 1.5 * x - 0.5 * z
        z = project_on_cone(relaxed + dual)
        dual = dual + relaxed - z
    return z


def random_problem(seed: int, contacts: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A compliance with stiff and soft directions, some contacts open, some pressed and dragged."""
    random = np.random.default_rng(seed)
    factor = random.normal(size=(3 * contacts, 3 * contacts))
    matrix = factor @ factor.T / contacts + 0.2 * np.eye(3 * contacts)
    rigid = np.tile(np.eye(3), (contacts, 1))
    dragged = np.tile([-1.0, 60.0, 20.0], contacts)
    return matrix + 50.0 * rigid @ rigid.T, random.normal(size=3 * contacts) + dragged


def rigid_problem(seed: int, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """A nearly rigid body pushed and turned onto 16 points of a plane: W = rigid motion + 1 / stiffness."""
    random = np.random.default_rng(seed)
    places = np.column_stack([np.zeros(16), random.uniform(-1.0, 1.0, (16, 2))])
    cross = np.cross(np.eye(3)[None], places[:, None])  # row k: e_k x place
    jacobian = np.concatenate([np.tile(np.eye(3), (16, 1, 1)), cross.transpose(0, 2, 1)], axis=2).reshape(48, 6)
    motion = np.array([-1.0, 0.6, 0.2, 0.3, 0.1, -0.2]) + 0.1 * random.normal(size=6)
    return jacobian @ jacobian.T + np.eye(48) / stiffness, jacobian @ motion


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
def test_agrees_with_admm(seed):
    """An independent method finds the same forces."""
    matrix, offset = random_problem(seed)
    by_admm = admm(matrix, offset)
    assert residual(matrix, offset, by_admm) < TOLERANCE
    np.testing.assert_allclose(solve(matrix, offset), by_admm, atol=1e-7)


@pytest.mark.parametrize("stiffness", [1e2, 1e6])
@pytest.mark.parametrize("seed", range(4))
def test_nearly_rigid_body(seed, stiffness):
    """Compliances over six decades are solved, too, from no force and from a wrong one."""
    matrix, offset = rigid_problem(seed, stiffness)
    wrong = np.tile([0.5, 0.2, -0.2], (16, 1))
    for start in (None, wrong):
        force, _ = solve_with_attempts(matrix, offset, start=start)
        assert residual(matrix, offset, force) < 1.01 * TOLERANCE


def test_points_that_depend_on_each_other():
    """Contacts given twice carry together what one of them carries alone."""
    matrix, offset = random_problem(0)
    once = solve(matrix, offset)
    twice = solve(np.tile(matrix, (2, 2)), np.tile(offset, 2))
    np.testing.assert_allclose(twice[: len(once)] + twice[len(once) :], once, atol=1e-6)


def test_without_friction():
    """mu = 0, where the cone is a half-line: normal forces of the complementarity problem, no tangential ones."""
    matrix, offset = random_problem(1)
    force, _ = solve_with_attempts(matrix, offset, friction=0.0)
    assert np.abs(force[:, 1:]).max() == 0.0
    gap = (matrix @ force.ravel() + offset)[::3]
    assert (gap > -1e-8).all() and (force[:, 0] >= 0.0).all() and np.abs(gap * force[:, 0]).max() < 1e-8


def test_without_friction_nor_slip():
    """mu = 0 and motions along the normal alone, where cone and disk shrink to a line and a point: solved at once."""
    for gap, expected in ((0.3, 0.0), (-0.3, 0.3)):
        force, attempts = solve_with_attempts(np.eye(3), np.array([gap, 0.0, 0.0]), friction=0.0)
        np.testing.assert_allclose(force, [[expected, 0.0, 0.0]], atol=1e-12)
        assert attempts == 1


def test_broken_problem_leaves_the_first_guess():
    """Where numbers are not finite, as in a diverging world, no forces of another problem are left over."""
    solver, start = ContactSolver(1, 1, wp.get_device("cpu")), np.array([[1.0, 0.1, 0.0]])
    solve_with_attempts(np.eye(3), np.array([-2.0, 0.0, 0.0]), start=start, solver=solver)
    force, attempts = solve_with_attempts(np.eye(3), np.full(3, np.nan), start=start, solver=solver)
    assert attempts == ATTEMPTS
    np.testing.assert_array_equal(force, start)


@wp.kernel
def _interior_point(
    problems: coulomb.ContactProblems,
    buffers: InteriorPointBuffers,
    level: wp.float64,
    tolerance: wp.float64,
    residual_out: wp.array[wp.float64],
):
    """The method alone."""
    residual_out[0] = interior_point(problems, buffers, 0, level, tolerance)


@pytest.mark.parametrize("level", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("seed", range(3))
def test_interior_points_alone(seed, level):
    """Without a guess, whatever the level it starts from, it comes near the solution that Newton's method finds."""
    matrix, offset = random_problem(seed)
    solver, out = ContactSolver(1, len(offset) // 3, wp.get_device("cpu")), wp.zeros(1, dtype=wp.float64, device="cpu")
    inputs = [problem_of(matrix, offset), solver._interior, level, TOLERANCE]
    wp.launch(_interior_point, dim=1, inputs=inputs, outputs=[out], device="cpu")
    best = solver._interior.best.numpy()[0]
    assert out.numpy()[0] == pytest.approx(residual(matrix, offset, best), rel=1e-3, abs=1e-12)
    np.testing.assert_allclose(best, solve(matrix, offset), atol=1e-6)


def test_no_solution_is_the_best_found():
    """A rigid wall that nothing can push away leaves a residual and all attempts, but finite forces."""
    matrix, offset = np.zeros((3, 3)), np.array([-1.0, 0.0, 0.0])
    matrix[1, 1] = matrix[2, 2] = 1.0
    force, attempts = solve_with_attempts(matrix, offset)
    assert attempts == ATTEMPTS and np.isfinite(force).all() and residual(matrix, offset, force) > TOLERANCE


def test_kernel_judges_like_the_formula():
    """The residual that ends a step is that of the natural map."""
    matrix, offset = random_problem(2)
    force = np.random.default_rng(5).normal(size=(len(offset) // 3, 3))
    motion = (matrix @ force.ravel() + offset).reshape(1, -1, 3)
    arrays = [wp.array(a, dtype=vec3d, device="cpu") for a in (force[None], motion)]
    out = wp.zeros(1, dtype=wp.float64, device="cpu")
    count, scale = wp.array([len(force)], dtype=int), wp.array([scale_of(matrix)])
    inputs = [ONE_ROW.device, count, FRICTION, scale, *arrays]
    wp.launch(coulomb.contact_residual, dim=1, inputs=inputs, outputs=[out], device="cpu")
    assert out.numpy()[0] == pytest.approx(residual(matrix, offset, force), rel=1e-12)


def test_no_contact_at_all():
    """Nothing to solve is solved at once."""
    force, attempts = solve_with_attempts(np.empty((0, 0)), np.empty(0))
    assert len(force) == 0 and attempts == 0


@wp.kernel
def _solve_linear(matrix: wp.array3d[mat33d], x: wp.array2d[vec3d]):
    """Solve one system per row."""
    i = wp.tid()
    factorise(matrix, i, matrix.shape[1])
    solve_factorised(matrix, i, matrix.shape[1], x, i)


def test_block_elimination_agrees_with_lapack():
    """Factors of 3 x 3 blocks solve what LAPACK solves."""
    random = np.random.default_rng(3)
    matrix = random.normal(size=(2, 21, 21)) + 8.0 * np.eye(21)
    right_side = random.normal(size=(2, 21))
    a = wp.array(np.stack([blocks(m) for m in matrix]), dtype=mat33d, device="cpu")
    x = wp.array(right_side.reshape(2, 7, 3), dtype=vec3d, device="cpu")
    wp.launch(_solve_linear, dim=2, inputs=[a, x], device="cpu")
    expected = np.linalg.solve(matrix, right_side[:, :, None]).reshape(2, 7, 3)
    np.testing.assert_allclose(x.numpy(), expected, rtol=1e-10, atol=1e-12)


@wp.kernel
def _solve_symmetric(
    half: wp.array2d[mat33d],
    rest: wp.array3d[mat33d],
    others: wp.array2d[vec3d],
    pivots: int,
    x: wp.array2d[vec3d],
    product: wp.array2d[vec3d],
):
    """Take the product A x, then solve A x = b per row: the first unknowns by symmetric elimination."""
    i = wp.tid()
    count = x.shape[1]
    multiply_symmetric(half, i, count, x, product, i)
    eliminate_symmetric(half, i, count, pivots)
    substitute_forwards(half, i, count, pivots, x, i, 0)
    for a in range(count - pivots):
        for b in range(count - pivots):
            rest[i, a, b] = block_of_symmetric(half, i, pivots + a, pivots + b, count)
    factorise(rest, i, count - pivots)
    for a in range(count - pivots):
        others[i, a] = x[i, pivots + a]
    solve_factorised(rest, i, count - pivots, others, i)
    for a in range(count - pivots):
        x[i, pivots + a] = others[i, a]
    scale_by_pivots(half, i, count, pivots, x, i)
    substitute_backwards(half, i, count, pivots, x, i)


@pytest.mark.parametrize("pivots", [0, 4, 7])
def test_symmetric_elimination_agrees_with_lapack(pivots):
    """The upper half of a matrix is enough for its products and systems, whatever part of them is eliminated so."""
    random = np.random.default_rng(4)
    factor, right_side = random.normal(size=(2, 21, 21)), random.normal(size=(2, 21))
    matrix = factor @ factor.transpose(0, 2, 1) + np.eye(21)
    half = wp.array(np.stack([upper_half(m) for m in matrix]), dtype=mat33d, device="cpu")
    x = wp.array(right_side.reshape(2, 7, 3), dtype=vec3d, device="cpu")
    rest, others, product = wp.zeros((2, 7, 7), dtype=mat33d, device="cpu"), wp.zeros_like(x), wp.zeros_like(x)
    wp.launch(_solve_symmetric, dim=2, inputs=[half, rest, others, pivots, x, product], device="cpu")
    np.testing.assert_allclose(product.numpy(), (matrix @ right_side[:, :, None]).reshape(2, 7, 3), rtol=1e-10)
    expected = np.linalg.solve(matrix, right_side[:, :, None]).reshape(2, 7, 3)
    np.testing.assert_allclose(x.numpy(), expected, rtol=1e-8)
