"""The frictional contact problem of one world: Signorini's and Coulomb's exact laws over a small dense matrix.

Given w(lambda) = W lambda + q, find for each contact

    0 <= w_n  _|_  lambda_n >= 0,    |lambda_t| <= mu lambda_n,    w_t != 0  =>  lambda_t = -mu lambda_n w_t / |w_t|,

which is  K  contains  lambda  _|_  w + mu |w_t| n  in  K*  with the Coulomb cone K (De Saxce). The residual of a
solution is that of the natural map, |lambda - Proj_K(lambda - (w + mu |w_t| n) / rho)| [N], largest over the contacts.

A semismooth Newton method starts from the forces of the iteration before; it mostly needs one to four linear systems.
Where it gets stuck it starts again, with another scaling and then from random forces; these are the same in every run.
Vectors of a contact are (normal, tangential, tangential).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

MAX_NEWTON_ITERATIONS = 30
"""For one attempt."""
RANDOM_STARTS = 10
"""Attempts from random forces; on the hardest problems that were seen, one in three succeeds."""
MEMORY = 5
"""Iterations over which the line search compares: a step may climb out of a local minimum of the norm."""
NEWTON_REGULARISATION = 1e-6
"""Shift of the diagonal [-]: neighbouring points can depend on each other, this picks one of the equal solutions."""
TINY = 1e-300
"""Keeps a division by a length of zero finite."""
SUFFICIENT_DECREASE = 0.1
STEP_SHRINKAGE = 0.3
SHORTEST_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """One world's contacts."""

    matrix: np.ndarray
    """W [m/N], shape ``(3 contact, 3 contact)``, symmetric positive semi-definite."""
    offset: np.ndarray
    """q [m], shape ``(3 contact,)``."""
    friction: float
    """Coulomb's mu [-]."""
    rho: float
    """Elastic self-compliance of a contact [m/N], the scale of the natural map."""

    def motion(self, force: np.ndarray) -> np.ndarray:
        """Return w [m] of forces [N], both ``(3 contact,)``."""
        return self.matrix @ force + self.offset

    def residual(self, force: np.ndarray, motion: np.ndarray) -> float:
        """Return the largest distance of a contact from its law [N]."""
        f, w = force.reshape(-1, 3), motion.reshape(-1, 3)
        target = project_on_cone(f - with_de_saxce(w, self.friction) / self.rho, self.friction)
        return float(np.sqrt(np.square(f - target).sum(axis=1).max(initial=0.0)))


def solve_contacts(problem: ContactProblem, start: np.ndarray, tolerance: float) -> tuple[np.ndarray, bool]:
    """Find the forces that obey the laws to a residual of ``tolerance`` [N].

    Args:
        problem: The contacts.
        start: First guess [N], shape ``(3 contact,)``.
        tolerance: Largest accepted residual [N].

    Returns:
        Forces [N], shape ``(3 contact,)``, and whether the first attempt failed. Forces that obey the laws less well
        than asked for are the best that were found; the caller's own residual tells.
    """
    best, least = start, np.inf
    for number, (guess, scale, memory) in enumerate(_attempts(problem, start)):
        force, residual = semismooth_newton(problem, scale, guess, tolerance, memory)
        if residual < least:
            best, least = force, residual
        if residual <= tolerance:
            return best, number > 0
    return best, True


def _attempts(problem: ContactProblem, start: np.ndarray) -> Iterator[tuple[np.ndarray, float, int]]:
    """Yield first guess, scale and memory for Newton's method, most promising first.

    From force to motion there is an elastic scale and one of the rigid body. The best mostly lies between them, but each
    combination fails on problems that another one solves. Random guesses are normal forces without friction.
    """
    elastic, mean = problem.rho, 0.2 * np.sqrt(problem.rho * np.trace(problem.matrix))
    yield start, mean, MEMORY
    yield start, elastic, 1
    yield start, 10.0 * elastic, 1
    random, level = np.random.default_rng(len(start)), 2.0 * np.abs(start[::3]).mean()
    for _ in range(RANDOM_STARTS):
        guess = np.zeros_like(start)
        guess[::3] = level * random.random(len(start) // 3)
        yield guess, mean, MEMORY


def semismooth_newton(
    problem: ContactProblem, scale: float, start: np.ndarray, tolerance: float, memory: int = 1
) -> tuple[np.ndarray, float]:
    """Newton's method on Alart and Curnier's function (1991), with a line search on its norm.

    Phi(lambda) = lambda - (max(0, lambda_n - w_n / r), P_disk(lambda_t - w_t / r)) with disk radius
    mu max(0, lambda_n - w_n / r).

    Args:
        problem: The contacts.
        scale: r [m/N], from force to motion; it sets the path, not the solution.
        start: First guess [N], shape ``(3 contact,)``.
        tolerance: Residual of the natural map at which to stop [N].
        memory: Number of iterations whose largest norm a step must undercut; 1 lets the norm only fall.

    Returns:
        Forces [N], shape ``(3 contact,)``, and the residual of the natural map [N].
    """
    force, motion = start, problem.motion(start)
    trial = force - motion / scale
    value = force - _alart_curnier(trial, problem.friction)
    norms = [np.linalg.norm(value)]
    for _ in range(MAX_NEWTON_ITERATIONS):
        residual = problem.residual(force, motion)
        if residual <= tolerance:
            return force, residual
        direction = _newton_direction(problem, scale, trial, value)
        if direction is None:
            return force, residual
        change, reference, length = problem.matrix @ direction, max(norms[-memory:]), 1.0
        if not np.isfinite(change @ change):
            return force, residual
        while True:
            next_force, next_motion = force + length * direction, motion + length * change
            trial = next_force - next_motion / scale
            value = next_force - _alart_curnier(trial, problem.friction)
            norm = np.linalg.norm(value)
            if norm < (1.0 - SUFFICIENT_DECREASE * length) * reference or length < SHORTEST_STEP:
                break
            length *= STEP_SHRINKAGE
        norms.append(norm)
        force, motion = next_force, next_motion
    return force, problem.residual(force, motion)


def _newton_direction(problem: ContactProblem, scale: float, trial: np.ndarray, value: np.ndarray) -> np.ndarray | None:
    """Solve the linearised system; contacts that are open at ``trial`` just give up their force.

    Args:
        problem: The contacts.
        scale: r [m/N].
        trial: lambda - w / r [N], shape ``(3 contact,)``.
        value: Phi [N], shape ``(3 contact,)``.

    Returns:
        Direction [N], shape ``(3 contact,)``, or None where the system is singular.
    """
    trial = trial.reshape(-1, 3)
    pressed = np.flatnonzero(trial[:, 0] > 0.0)
    direction = -value
    if not len(pressed):
        return direction
    rows = (3 * pressed[:, None] + np.arange(3)).ravel()
    direction[rows] = 0.0
    slope = _alart_curnier_slope(trial[pressed], problem.friction)
    # (1 - S (1 - W / r)) d = -Phi - S W d_open / r over the pressed contacts
    block = problem.matrix.take(rows, axis=0).take(rows, axis=1)
    block /= scale
    block.reshape(-1)[:: len(rows) + 1] -= 1.0
    system = np.matmul(slope, block.reshape(len(pressed), 3, -1)).reshape(block.shape)
    system.reshape(-1)[:: len(rows) + 1] += 1.0 + NEWTON_REGULARISATION
    pushed = (problem.matrix @ direction)[rows].reshape(-1, 3, 1) / scale
    right_side = -value[rows] - np.matmul(slope, pushed).ravel()
    try:
        direction[rows] = np.linalg.solve(system, right_side)
    except np.linalg.LinAlgError:
        return None
    return direction


def _alart_curnier(trial: np.ndarray, friction: float) -> np.ndarray:
    """Return (max(0, n), projection of t on the disk of radius mu max(0, n)); shapes ``(3 contact,)`` [N]."""
    trial = trial.reshape(-1, 3)
    normal = np.maximum(trial[:, 0], 0.0)
    radius, length = friction * normal, np.hypot(trial[:, 1], trial[:, 2])
    share = np.minimum(1.0, radius / np.maximum(length, TINY))
    return np.stack([normal, share * trial[:, 1], share * trial[:, 2]], axis=1).reshape(-1)


def _alart_curnier_slope(trial: np.ndarray, friction: float) -> np.ndarray:
    """Return an element of the generalised Jacobian of :func:`_alart_curnier` at pressed contacts.

    Args:
        trial: Pressed contacts, shape ``(contact, 3)``.
        friction: Coulomb's mu [-].

    Returns:
        Shape ``(contact, 3, 3)``.
    """
    slope = np.zeros((len(trial), 3, 3))
    slope[:, [0, 1, 2], [0, 1, 2]] = 1.0
    length, radius = np.hypot(trial[:, 1], trial[:, 2]), friction * trial[:, 0]
    sliding = np.flatnonzero(length > radius)
    if len(sliding):
        direction = trial[sliding, 1:] / length[sliding, None]
        across = np.eye(2) - direction[:, :, None] * direction[:, None, :]
        slope[sliding, 1:, 0] = friction * direction
        slope[sliding, 1:, 1:] = (radius[sliding] / length[sliding])[:, None, None] * across
    return slope


def project_on_cone(v: np.ndarray, friction: float) -> np.ndarray:
    """Return the points of the Coulomb cone |v_t| <= mu v_n closest to v, shape ``(contact, 3)``."""
    tangential = np.hypot(v[:, 1], v[:, 2])
    inside = tangential <= friction * v[:, 0]
    normal = np.maximum((v[:, 0] + friction * tangential) / (1.0 + friction**2), 0.0)
    share = np.where(inside, 1.0, friction * normal / np.maximum(tangential, TINY))
    return np.stack([np.where(inside, v[:, 0], normal), share * v[:, 1], share * v[:, 2]], axis=1)


def with_de_saxce(motion: np.ndarray, friction: float) -> np.ndarray:
    """Return w + mu |w_t| n, shape ``(contact, 3)``."""
    shifted = motion.copy()
    shifted[:, 0] += friction * np.hypot(motion[:, 1], motion[:, 2])
    return shifted
