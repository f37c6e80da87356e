"""Buffers and launches around the kernels that solve the contact problems."""

from __future__ import annotations

import warp as wp

from defgrasp_ros.simulation.kernels_contact_solver import solve_contacts
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems
from defgrasp_ros.simulation.kernels_interior_point import InteriorPointBuffers
from defgrasp_ros.simulation.kernels_newton import NewtonBuffers
from defgrasp_ros.simulation.types import mat33d, vec3d


class ContactSolver:
    """Solves batches of up to ``row_count`` contact problems with up to ``capacity`` points each.

    Args:
        row_count: Number of problems.
        capacity: Contact points per problem.
        device: Where they are solved.
    """

    def __init__(self, row_count: int, capacity: int, device: wp.Device):
        self._device = device

        def vectors() -> wp.array:
            return wp.zeros((row_count, capacity), dtype=vec3d, device=device)

        system = wp.zeros((row_count, capacity, capacity), dtype=mat33d, device=device)
        self.force = vectors()
        """Solution (row, contact) [N]."""
        self.attempts = wp.zeros(row_count, dtype=int, device=device)
        """Methods that were tried for the last problem of each row; 1: the first one solved it."""
        self.systems = wp.zeros(row_count, dtype=int, device=device)
        """Linear systems of Newton's method for the last problem of each row."""
        self._newton = NewtonBuffers()
        for name in ("force", "motion", "centre", "direction", "change", "right_side"):
            setattr(self._newton, name, vectors())
        self._newton.pressed = wp.zeros((row_count, capacity), dtype=int, device=device)
        self._newton.system, self._newton.systems = system, self.systems
        self._interior = InteriorPointBuffers()
        for name in ("x", "z", "missing", "dx", "dz", "force", "motion", "best"):
            setattr(self._interior, name, vectors())
        self._interior.system = system

    def solve(self, problems: ContactProblems, start: wp.array, tolerance: wp.array) -> None:
        """Find the forces that obey the laws of contact; those that do it best where none do well enough.

        Args:
            problems: One per row.
            start: First guess (row, contact) [N].
            tolerance: Largest accepted residual (row,) [N].
        """
        wp.launch(
            solve_contacts,
            dim=problems.worlds.shape[0],
            inputs=[problems, start, tolerance, self._newton, self._interior],
            outputs=[self.force, self.attempts],
            device=self._device,
        )
