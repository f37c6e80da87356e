"""Solves the frictional contact problem of each world, and says how well.

ADMM first (see ``kernels_coulomb``); a world that it leaves unsolved goes to a semismooth Newton method on the host,
and from there, if need be, back to a long ADMM run. The problem is small and dense: a few tens of contacts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from defgrasp_ros.simulation import kernels_coulomb as kernels
from defgrasp_ros.simulation.dense import DeviceAlgebra, HostAlgebra
from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

SHORT_RUN = 60
"""ADMM iterations before Newton's method takes over."""
LONG_RUN = 3000
"""ADMM iterations after Newton's method has failed."""
CHECK_INTERVAL = 5
"""ADMM iterations between two looks of the host at what is done."""
NEWTON_ITERATIONS = 30
NEWTON_REGULARISATION = 1e-6
NEWTON_SCALES = (10.0, 1.0)
"""Scalings of motion to force, relative to ADMM's, tried in turn: each fails on problems that the other solves."""


@dataclass
class ContactProblem:
    """The contact problems of some worlds; row i of the buffers belongs to ``worlds[i]``.

    ``matrix`` W [m/N] and ``inverse`` (W + rho)^-1 [N/m] have shape ``(world, 3 contact, 3 contact)``;
    ``motion`` is w at the forces ``force`` (row, contact) and both are in contact frames.
    """

    worlds: wp.array
    count: wp.array
    friction: float
    rho: wp.array
    matrix: wp.array
    inverse: wp.array
    force: wp.array
    motion: wp.array
    tolerance: wp.array
    """Largest accepted residual of the natural map [N], shape ``(row,)``."""


class CoulombSolver:
    """Work buffers and the sequence of methods."""

    def __init__(self, rows: int, capacity: int, device: wp.Device, algebra: HostAlgebra | DeviceAlgebra):
        self.device = device
        self.algebra = algebra
        shape = (rows, capacity)
        self._z, self._dual, self._right_side, self._offset, self._x = (
            wp.zeros(shape, dtype=vec3d, device=device) for _ in range(5)
        )
        self._done = wp.zeros(rows, dtype=int, device=device)

    def solve(self, problem: ContactProblem) -> tuple[wp.array, np.ndarray]:
        """Return the forces, shape ``(row, contact)`` [N], and which rows ADMM's short run left unsolved."""
        rows, capacity = problem.worlds.shape[0], self._x.shape[1]
        sizes = 3 * problem.count.numpy()
        done = self._done[:rows]
        done.zero_()

        def product(matrix: wp.array, vector: wp.array, out: wp.array) -> Callable[[], None]:
            flat = [_as_scalars(a, rows) for a in (vector, out)]
            return self.algebra.world_product(matrix, problem.worlds, sizes, done, *flat)

        product(problem.matrix, problem.force, self._offset)()
        wp.launch(_subtract, dim=(rows, capacity), inputs=[problem.motion, self._offset], device=self.device)
        wp.launch(
            kernels.admm_start,
            dim=(rows, capacity),
            inputs=[
                problem.count,
                problem.worlds,
                problem.friction,
                problem.rho,
                self._offset,
                problem.force,
                problem.motion,
            ],
            outputs=[self._z, self._dual, self._right_side],
            device=self.device,
        )
        iteration = [
            product(problem.inverse, self._right_side, self._x),
            wp.launch(
                kernels.admm_project,
                dim=(rows, capacity),
                inputs=[problem.count, problem.worlds, done, problem.friction, problem.rho, self._offset, self._x],
                outputs=[self._z, self._dual, self._right_side],
                device=self.device,
                record_cmd=True,
            ).launch,
        ]
        check = [
            product(problem.matrix, self._z, self._x),
            wp.launch(
                kernels.admm_check,
                dim=rows,
                inputs=[problem.count, problem.worlds, problem.friction, problem.rho, problem.tolerance]
                + [self._offset, self._z, self._x],
                outputs=[done],
                device=self.device,
                record_cmd=True,
            ).launch,
        ]
        if self._iterate(iteration, check, done, SHORT_RUN):
            return self._z[:rows], np.zeros(rows, dtype=bool)
        unsolved = done.numpy() == 0
        self._newton(problem, sizes, np.flatnonzero(unsolved))
        self._iterate(iteration, check, done, LONG_RUN)
        return self._z[:rows], unsolved

    @staticmethod
    def _iterate(iteration: list[Callable], check: list[Callable], done: wp.array, limit: int) -> bool:
        """Run ADMM until every world is done; return whether that is so."""
        for count in range(limit + 1):
            if count % CHECK_INTERVAL == 0:
                for call in check:
                    call()
                if done.numpy().all():
                    return True
            for call in iteration:
                call()
        return False

    def _newton(self, problem: ContactProblem, sizes: np.ndarray, rows: np.ndarray) -> None:
        """Put Newton's solution of some rows into z and the dual; what failed keeps ADMM's iterate."""
        worlds, rho, tolerance = problem.worlds.numpy(), problem.rho.numpy(), problem.tolerance.numpy()
        z, offset = self._z.numpy(), self._offset.numpy()
        dual, right_side = self._dual.numpy(), self._right_side.numpy()
        matrices = problem.matrix.numpy()
        for i in rows:
            w, n = worlds[i], sizes[worlds[i]]
            matrix, q = matrices[w, :n, :n], offset[i].reshape(-1)[:n]
            force = None
            for scale in NEWTON_SCALES:
                start, goal = z[i].reshape(-1)[:n], 0.1 * tolerance[i] / scale
                trial, residual = semismooth_newton(matrix, q, problem.friction, scale * rho[w], start, goal)
                if residual <= goal:
                    force = trial
                    break
            if force is None:
                continue
            motion = (matrix @ force + q).reshape(-1, 3)
            motion[:, 0] += problem.friction * np.linalg.norm(motion[:, 1:], axis=1)
            contacts = n // 3
            z[i, :contacts] = force.reshape(-1, 3)
            dual[i, :contacts] = -motion / rho[w]
            shift = problem.friction * np.linalg.norm(motion[:, 1:], axis=1)
            right_side[i, :contacts] = rho[w] * z[i, :contacts] + motion - offset[i, :contacts]
            right_side[i, :contacts, 0] -= shift
        if self.device.is_cuda:
            for array, values in ((self._z, z), (self._dual, dual), (self._right_side, right_side)):
                array.assign(values)


def semismooth_newton(
    matrix: np.ndarray, offset: np.ndarray, friction: float, rho: float, start: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Solve one contact problem by Newton's method on Alart and Curnier's function, with a line search.

    Phi(lambda) = lambda - (max(0, lambda_n - w_n / r), P_disk(lambda_t - w_t / r)) with disk radius
    mu max(0, lambda_n - w_n / r), where r scales motion to force.

    Args:
        matrix: W [m/N], shape ``(3 contact, 3 contact)``.
        offset: q [m], shape ``(3 contact,)``, in contact frames.
        friction: Coulomb's mu [-].
        rho: Scale r [m/N].
        start: First guess [N], shape ``(3 contact,)``.
        tolerance: Residual at which to stop [N].

    Returns:
        Forces [N], shape ``(3 contact,)``, and the largest entry of Phi [N].
    """

    def function(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        trial = (force - (matrix @ force + offset) / rho).reshape(-1, 3)
        return force - _alart_curnier(trial, friction).reshape(-1), trial

    force = start.copy()
    value, trial = function(force)
    for _ in range(NEWTON_ITERATIONS):
        if np.abs(value).max(initial=0.0) < tolerance:
            break
        try:
            direction = _newton_direction(matrix / rho, trial, value, friction)
        except np.linalg.LinAlgError:
            break  # no direction from here; the residual tells that this is no solution
        length, merit = 1.0, np.linalg.norm(value)
        while length > 1e-3:
            candidate, candidate_trial = function(force + length * direction)
            if np.linalg.norm(candidate) < (1.0 - 0.1 * length) * merit:
                break
            length *= 0.5
        force = force + length * direction
        value, trial = (candidate, candidate_trial) if length > 1e-3 else function(force)
    return force, float(np.abs(value).max(initial=0.0))


def _newton_direction(scaled: np.ndarray, trial: np.ndarray, value: np.ndarray, friction: float) -> np.ndarray:
    """Solve the linearised system; contacts that are open at ``trial`` just give up their force.

    Args:
        scaled: W / r [-], shape ``(3 contact, 3 contact)``.
        trial: lambda - w / r [N], shape ``(contact, 3)``.
        value: Phi [N], shape ``(3 contact,)``.
        friction: Coulomb's mu [-].
    """
    pressed = np.repeat(trial[:, 0] > 0.0, 3)
    direction = -value
    if not pressed.any():
        return direction
    slope = _alart_curnier_slope(trial[trial[:, 0] > 0.0], friction)
    rows = scaled[pressed]
    system = np.eye(len(rows)) - _block_times(slope, np.eye(len(rows)) - rows[:, pressed])
    # Neighbouring points can depend on each other; the small shift picks one of their equivalent solutions.
    system[np.diag_indices(len(rows))] += NEWTON_REGULARISATION
    right_side = -value[pressed] - _block_times(slope, rows[:, ~pressed] @ direction[~pressed][:, None])[:, 0]
    direction[pressed] = np.linalg.solve(system, right_side)
    return direction


def _alart_curnier(trial: np.ndarray, friction: float) -> np.ndarray:
    """Return (max(0, n), projection of t on the disk of radius mu max(0, n)); shapes ``(contact, 3)`` [N]."""
    normal = np.maximum(trial[:, 0], 0.0)
    length = np.linalg.norm(trial[:, 1:], axis=1)
    radius = friction * normal
    scale = np.where(length > radius, radius / np.maximum(length, 1e-300), 1.0)
    return np.column_stack([normal, scale[:, None] * trial[:, 1:]])


def _alart_curnier_slope(trial: np.ndarray, friction: float) -> np.ndarray:
    """Return an element of the generalised Jacobian of :func:`_alart_curnier`, shape ``(contact, 3, 3)``."""
    slope = np.zeros((len(trial), 3, 3))
    normal, tangential = trial[:, 0], trial[:, 1:]
    length = np.linalg.norm(tangential, axis=1)
    pressed = normal > 0.0
    slope[pressed, 0, 0] = 1.0
    sticking = pressed & (length <= friction * normal)
    slope[sticking, 1, 1] = slope[sticking, 2, 2] = 1.0
    sliding = pressed & ~sticking
    direction = tangential[sliding] / length[sliding, None]
    slope[sliding, 1:, 0] = friction * direction
    across = np.eye(2) - direction[:, :, None] * direction[:, None, :]
    slope[sliding, 1:, 1:] = (friction * normal[sliding] / length[sliding])[:, None, None] * across
    return slope


def _block_times(blocks: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return blockdiag(blocks) @ matrix."""
    return np.einsum("cij,cjk->cik", blocks, matrix.reshape(len(blocks), 3, -1)).reshape(matrix.shape)


def _as_scalars(vectors: wp.array, rows: int) -> wp.array:
    """The first rows of an array of vectors as an array of numbers, shape ``(row, 3 contact)``, without copying."""
    shape = (rows, 3 * vectors.shape[1])
    return wp.array(ptr=vectors.ptr, dtype=wp.float64, shape=shape, device=vectors.device)


@wp.kernel
def _subtract(minuend: wp.array2d[vec3d], difference: wp.array2d[vec3d]):
    """difference = minuend - difference."""
    i, c = wp.tid()
    difference[i, c] = minuend[i, c] - difference[i, c]
