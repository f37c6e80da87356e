"""Newton's systems of the contact problems, solved with the factors of earlier ones."""

import numpy as np
import pytest
import warp as wp
from test_contact_solver import FRICTION, TOLERANCE, problem_of, random_problem
from test_simulator import STEP, held_block

from defgrasp_ros.simulation import kernels_coulomb as coulomb
from defgrasp_ros.simulation.contact_solver import ContactSolver
from defgrasp_ros.simulation.kernels_contact_solver import ATTEMPTS
from defgrasp_ros.simulation.kernels_newton_system import COLUMNS, NewtonSystems, find_direction
from defgrasp_ros.simulation.rows import RowList
from defgrasp_ros.simulation.types import mat33d, vec3d

STICKING, SLIDING, OPEN = np.array([1.0, 0.1, 0.2]), np.array([1.0, 0.8, -0.6]), np.array([-0.5, 0.3, 0.1])
"""Values of lambda - w / r [N]."""


@wp.kernel
def _find_direction(
    problems: coulomb.ContactProblems,
    systems: NewtonSystems,
    force: wp.array2d[vec3d],
    motion: wp.array2d[vec3d],
    scale: wp.float64,
    shift: wp.float64,
):
    """The direction of Newton's method alone."""
    find_direction(problems, systems, force, motion, 0, scale, shift)


class Systems:
    """Directions for one compliance, from one solver."""

    def __init__(self, contacts: int = 20, scale: float = 2.0, shift: float = 0.0):
        self.matrix, self.scale, self.shift = random_problem(0, contacts)[0], scale, shift
        self._solver = ContactSolver(1, contacts, wp.get_device("cpu"))
        self._forces = np.random.default_rng(1)

    def factorised(self) -> int:
        """Return how many systems were factorised."""
        return int(self._solver.factorised.numpy()[0])

    def direction(self, trial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the solver's direction for an iterate with the given lambda - w / r, and that of a dense solution."""
        force = self._forces.normal(size=trial.shape)
        motion = self.scale * (force - trial)
        arrays = [wp.array(a[None], dtype=vec3d, device="cpu") for a in (force, motion)]
        problem, systems = problem_of(self.matrix, np.zeros(self.matrix.shape[0])), self._solver._newton.systems
        wp.launch(_find_direction, dim=1, inputs=[problem, systems, *arrays, self.scale, self.shift], device="cpu")
        return systems.direction.numpy()[0].copy(), self._dense(trial, force)

    def _dense(self, trial: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Solve (1 - S + S (W + s) / r) d = -Phi, with slopes from differences."""
        count, step = len(trial), 1e-6
        slope = np.zeros((3 * count, 3 * count))
        for c in range(count):
            for k in range(3):
                moved = step * np.eye(3)[k]
                difference = projected(trial[c] + moved) - projected(trial[c] - moved)
                slope[3 * c : 3 * c + 3, 3 * c + k] = difference / (2.0 * step)
        one = np.eye(3 * count)
        system = one - slope + slope @ (self.matrix + self.shift * one) / self.scale
        value = force - np.array([projected(t) for t in trial])
        return np.linalg.solve(system, -value.ravel()).reshape(-1, 3)


def projected(trial: np.ndarray) -> np.ndarray:
    """Return (max(0, n), P_disk(t))."""
    normal, tangential = max(trial[0], 0.0), np.linalg.norm(trial[1:])
    return np.array([normal, *(trial[1:] * min(1.0, FRICTION * normal / tangential))])


def mixed(contacts: int = 20) -> np.ndarray:
    """Iterate with contacts of all kinds, most of them sticking."""
    trial = np.tile(STICKING, (contacts, 1))
    trial[::4], trial[1::6] = SLIDING, OPEN
    return trial


@pytest.mark.parametrize("shift", [0.0, 0.3])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {2: OPEN},
        {1: STICKING},
        {1: SLIDING},
        {0: STICKING},
        {2: SLIDING},
        {0: OPEN},
        {0: np.array([1.0, -0.5, 0.9])},
        {2: OPEN, 1: SLIDING, 3: SLIDING},
    ],
    ids=["none", "opens", "closes", "closes and slides", "sticks", "slides", "slid and opens", "turns", "several"],
)
def test_reused_factors_give_the_direction(changes, shift):
    """Whatever contacts do, the factors of the system before give the direction that a dense solution gives."""
    systems, trial = Systems(shift=shift), mixed()
    systems.direction(trial)
    for c, value in changes.items():
        trial[c] = value
    for _ in range(2):  # the second time with columns that are there already
        direction, expected = systems.direction(trial)
        np.testing.assert_allclose(direction, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert systems.factorised() == 1


def test_open_contacts_lose_their_force_exactly():
    """No rounding is left of the force of a contact that opens."""
    systems, trial = Systems(), mixed()
    systems.direction(trial)
    trial[2] = OPEN
    direction, _ = systems.direction(trial)
    np.testing.assert_array_equal(direction[2], -systems._solver._newton.systems.value.numpy()[0, 2])


def test_sliding_contacts_turn_freely():
    """Contacts that slid when the factors were made may slide elsewhere, stick or open: no columns, no new factors."""
    systems, trial = Systems(), mixed()
    systems.direction(trial)
    trial[0], trial[4], trial[8] = [1.0, -0.5, 0.9], STICKING, OPEN
    direction, expected = systems.direction(trial)
    np.testing.assert_allclose(direction, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert systems.factorised() == 1
    assert systems._solver._base.column_count.numpy()[0] == 0


def test_differences_are_not_paid_for_twice():
    """Where systems differ from the base in the same way again and again, there are new factors in the end."""
    systems, trial = Systems(60), np.tile(STICKING, (60, 1))
    systems.direction(trial)
    trial[:12] = OPEN
    solved = 0
    while systems.factorised() == 1 and solved < 100:
        systems.direction(trial)
        solved += 1
    assert 2 < solved < 100
    assert systems._solver._base.column_count.numpy()[0] == 0


def test_too_many_changes_are_factorised():
    """Where more contacts changed than a world keeps columns, or most of them, there are new factors."""
    contacts = 6 * int(COLUMNS)
    systems, trial = Systems(contacts), np.tile(STICKING, (contacts, 1))
    systems.direction(trial)
    for first in range(0, 40, 10):
        trial[first : first + 10] = SLIDING
        direction, expected = systems.direction(trial)
        np.testing.assert_allclose(direction, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert systems.factorised() == 2  # the fourth ten found no room
    trial[:] = SLIDING
    direction, expected = systems.direction(trial)
    np.testing.assert_allclose(direction, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert systems.factorised() == 3


def test_wrong_factors_are_noticed():
    """Where the factors are those of another compliance, though nobody said so, the direction is the right one."""
    systems, trial = Systems(), mixed()
    systems.direction(trial)
    systems.matrix = random_problem(1, len(trial))[0]
    direction, expected = systems.direction(trial)
    np.testing.assert_allclose(direction, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert systems.factorised() == 2


def pressed_problem(contacts: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """A problem most of whose contacts carry a force."""
    matrix, offset = random_problem(3, contacts)
    return matrix, offset - np.tile([100.0, 0.0, 0.0], contacts)


def solve_on(solver: ContactSolver, problem: coulomb.ContactProblems) -> np.ndarray:
    """Forces of one problem, shape ``(contact, 3)``."""
    rows = RowList(1, wp.get_device("cpu")).assign(problem.worlds.numpy())
    solver.solve(rows, problem, wp.full(2, TOLERANCE, dtype=wp.float64, device="cpu"))
    return solver.force.numpy()[0].copy()


def test_forgotten_factors_are_not_used():
    """After ``forget`` a solver gives what a new one gives, bit by bit, also for a compliance that hardly changed."""
    used, fresh = (ContactSolver(1, 16, wp.get_device("cpu")) for _ in range(2))
    matrix, offset = pressed_problem()
    other = matrix + 1e-4 * (np.eye(48, k=3) + np.eye(48, k=-3))  # the same scale
    start = solve_on(used, problem_of(matrix, offset))
    used.forget(RowList(1, wp.get_device("cpu")).assign(np.array([0])))
    by_used, by_fresh = (solve_on(solver, problem_of(other, offset, start=start)) for solver in (used, fresh))
    np.testing.assert_array_equal(by_used, by_fresh)
    assert used.factorised.numpy()[0] == fresh.factorised.numpy()[0] > 0


def test_worlds_do_not_disturb_each_other():
    """Problems of one world that take all attempts, or break down, leave the factors of another alone."""
    matrix, offset = pressed_problem()
    no_solution = np.zeros_like(matrix)
    no_solution[1::3, 1::3] = no_solution[2::3, 2::3] = np.eye(16)
    together, alone = ContactSolver(2, 16, wp.get_device("cpu")), ContactSolver(1, 16, wp.get_device("cpu"))
    start, reused = np.zeros_like(offset), 0
    for change in (0.0, 0.01, 0.02):
        problem = problem_of(matrix, offset + change, start=start)
        force = solve_on(alone, problem)
        np.testing.assert_array_equal(solve_on(together, in_world(0, problem)), force)
        assert together.factorised.numpy()[0] == alone.factorised.numpy()[0]
        reused += alone.systems.numpy()[0] - alone.factorised.numpy()[0]
        for broken in (offset, np.full(48, np.nan)):
            solve_on(together, in_world(1, problem_of(no_solution, broken)))
            assert together.attempts.numpy()[0] == ATTEMPTS
        start = force
    assert reused >= 2


def in_world(world: int, problem: coulomb.ContactProblems) -> coulomb.ContactProblems:
    """Make the one problem that of another world, still in row 0."""
    problem.worlds = wp.array([world], dtype=int, device="cpu")
    problem.count = wp.array(np.repeat(problem.count.numpy(), 2), dtype=int, device="cpu")
    problem.rho = wp.array(np.repeat(problem.rho.numpy(), 2), dtype=wp.float64, device="cpu")
    problem.matrix = wp.array(np.repeat(problem.matrix.numpy(), 2, axis=0), dtype=mat33d, device="cpu")
    return problem


def test_new_compliance_forgets_the_factors(monkeypatch):
    """Whenever a simulation assembles the compliance of a world anew, what its solver knew is forgotten."""
    forgotten = []
    forget = ContactSolver.forget
    monkeypatch.setattr(
        ContactSolver, "forget", lambda self, rows: (forgotten.append(list(rows.worlds)), forget(self, rows))
    )
    simulator = held_block((0.02, 0.02, 0.02), (3, 4, 3))
    contacts = simulator._shards[0].contacts
    before = contacts._problems.matrix.numpy().copy()
    forgotten.clear()
    simulator.step(np.array([0]), 0.5 * STEP, np.array([1.5]), np.array([-1.0]), quasi_static=True)
    assert (contacts._problems.matrix.numpy() != before).any()
    assert forgotten[:1] == [[0]]
