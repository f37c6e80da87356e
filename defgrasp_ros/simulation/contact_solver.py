"""Buffers and launches around the kernels that solve the contact problems."""

from __future__ import annotations

import warp as wp

from defgrasp_ros.simulation.kernels_block_matrix import half_size
from defgrasp_ros.simulation.kernels_contact_solver import solve_contacts
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems
from defgrasp_ros.simulation.kernels_interior_point import InteriorPointBuffers
from defgrasp_ros.simulation.kernels_newton import NewtonBuffers
from defgrasp_ros.simulation.kernels_newton_system import COLUMNS, Base, NewtonSystems
from defgrasp_ros.simulation.rows import Launcher, RowList, Rows, world_of
from defgrasp_ros.simulation.types import mat33d, vec3d


class ContactSolver:
    """Solves the contact problems of up to ``world_count`` worlds with up to ``capacity`` points each.

    Args:
        world_count: Number of worlds.
        capacity: Contact points per world.
        device: Where they are solved.
    """

    def __init__(self, world_count: int, capacity: int, device: wp.Device):
        self._launch = Launcher(device)

        def zeros(dtype, *shape: int) -> wp.array:
            return wp.zeros((world_count, *shape), dtype=dtype, device=device)

        self.force = zeros(vec3d, capacity)
        """Solution (row, contact) [N]."""
        self.attempts = zeros(int)
        """Methods that were tried for the last problem of each row; 1: the first one solved it."""
        self.systems = zeros(int)
        """Linear systems of Newton's method for the last problem of each row."""
        self.factorised = zeros(int)
        """How many of them had to be factorised."""

        base = self._base = Base()
        base.valid, base.sticking_count, base.pressed_count, base.column_count = (zeros(int) for _ in range(4))
        base.scale, base.shift, base.spent = (zeros(wp.float64) for _ in range(3))
        base.pressed, base.place, base.column_of = (zeros(int, capacity) for _ in range(3))
        base.factors = zeros(mat33d, half_size(capacity))
        base.contact, base.product = zeros(int, COLUMNS), zeros(mat33d, COLUMNS, COLUMNS)
        base.column = wp.zeros((world_count * COLUMNS, capacity), dtype=mat33d, device=device)

        systems = NewtonSystems()
        systems.base, systems.solved, systems.factorised = base, self.systems, self.factorised
        for name in ("value", "direction", "change", "load", "part", "unknown"):
            setattr(systems, name, zeros(vec3d, capacity))
        systems.slope, systems.column_part = zeros(mat33d, capacity), zeros(mat33d, capacity)
        systems.changed, systems.matrix = zeros(int, COLUMNS), zeros(mat33d, capacity, capacity)

        self._newton = NewtonBuffers()
        self._newton.systems = systems
        for name in ("force", "motion", "centre"):
            setattr(self._newton, name, zeros(vec3d, capacity))

        self._interior = InteriorPointBuffers()
        self._interior.system = systems.matrix
        for name in ("offset", "x", "z", "missing", "dx", "dz", "force", "motion", "best"):
            setattr(self._interior, name, zeros(vec3d, capacity))

    def forget(self, rows: RowList) -> None:
        """The matrices of these worlds have changed: what is known of them is of no use any more."""
        self._launch(_forget, (rows,), [self._base])

    def solve(self, rows: RowList, problems: ContactProblems, tolerance: wp.array) -> None:
        """Find the forces that obey the laws of contact; those that do it best where none do well enough.

        Args:
            rows: Worlds, those of the problems.
            problems: One per row. The matrix of a world is the one before, unless ``forget`` was told.
            tolerance: Largest accepted residual (world,) [N].
        """
        inputs = [problems, tolerance, self._newton, self._interior]
        self._launch(solve_contacts, (rows,), [*inputs, self.force, self.attempts])


@wp.kernel
def _forget(rows: Rows, base: Base):
    """No factors are known."""
    w = world_of(rows, wp.tid())
    if w >= 0:
        base.valid[w] = 0
