"""Some of the worlds, with all that it takes to step them; independent of the others, so that threads can share out
the work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from defgrasp_ros.simulation import kernels_faces as faces
from defgrasp_ros.simulation.contact_set import ContactSet
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.shared_compliance import ComplianceCache
from defgrasp_ros.simulation.stepper import Stepper, StepReport
from defgrasp_ros.simulation.world_state import WorldState, set_entries

STEP_CUT = 4
"""Number of smaller steps that replace one that did not converge."""
MAX_CUTS = 2
"""How often a step may be cut before its world is given up."""


@dataclass(frozen=True, eq=False)
class WorldSnapshot:
    """One world at one instant, on the host; other worlds can go on from there."""

    state: list[np.ndarray]
    contacts: dict[str, np.ndarray]
    force_scale: float


class Shard:
    """State, contacts and stepping of ``world_count`` worlds; indices of worlds are its own, from 0."""

    def __init__(self, model: DeviceModel, compliances: ComplianceCache, world_count: int, device: wp.Device):
        self._compliances = compliances
        self.state = WorldState(world_count, model.node_count, device)
        self.contacts = ContactSet(model, self.state, world_count, device)
        self.force_scale = np.zeros(world_count)
        """Force to which residuals are compared [N]."""
        self._stepper = Stepper(model, self.state, self.contacts, world_count, device)

    def snapshot(self, world: int) -> WorldSnapshot:
        """Return all that is known about a world."""
        return WorldSnapshot(self.state.snapshot(world), self.contacts.snapshot(world), self.force_scale[world])

    def restore(self, world: int, snapshot: WorldSnapshot) -> None:
        """Make a world what another was."""
        self.state.restore(world, snapshot.state)
        self.contacts.restore(world, snapshot.contacts)
        self.force_scale[world] = snapshot.force_scale

    def step(
        self,
        worlds: np.ndarray,
        step_length: float,
        closing_force: np.ndarray,
        platform_height: np.ndarray,
        *,
        quasi_static: bool,
    ) -> StepReport:
        """Advance some worlds by one step; see :meth:`Simulator.step`."""
        state = self.state
        start_force = state.closing_force.numpy()[worlds].copy()
        start_height = state.platform_heights(worlds)

        def advance(some: np.ndarray, pieces: int, piece: int) -> StepReport:
            """Take one of several equal pieces of the step."""
            share = piece / pieces
            set_entries(
                state.closing_force, worlds[some], start_force[some] + share * (closing_force - start_force)[some]
            )
            heights = start_height[some] + share * (platform_height - start_height)[some]
            set_entries(state.bodies.base, (worlds[some], faces.PLATFORM), heights)
            compliance = self._compliances[step_length / pieces]
            scale = self.force_scale[worlds[some]]
            return self._stepper.step(worlds[some], compliance, scale, quasi_static=quasi_static)

        report = advance(np.arange(len(worlds)), 1, 1)
        for cut in range(1, MAX_CUTS + 1):
            failed = np.flatnonzero(~report.converged)
            if not len(failed):
                break
            self._advance_in_pieces(worlds, failed, cut, advance, report)
        bad = ~report.converged
        set_entries(state.closing_force, worlds[bad], start_force[bad])
        set_entries(state.bodies.base, (worlds[bad], faces.PLATFORM), start_height[bad])
        return report

    def _advance_in_pieces(self, worlds: np.ndarray, failed: np.ndarray, cut: int, advance, report: StepReport) -> None:
        """Repeat a step in smaller ones where it failed; a world that fails again goes back to where it began."""
        pieces = STEP_CUT**cut
        before = [array.numpy()[worlds[failed]].copy() for array in self.state.motion]
        report.cuts[failed] = cut
        report.residual[failed] = 0.0
        report.converged[failed] = True
        for piece in range(1, pieces + 1):
            good = failed[report.converged[failed]]
            if not len(good):
                break
            part = advance(good, pieces, piece)
            report.converged[good] = part.converged
            report.iterations[good] += part.iterations
            report.contact_fallbacks[good] += part.contact_fallbacks
            report.residual[good] = np.maximum(report.residual[good], part.residual)
            report.crushed[good] = part.crushed
        lost = ~report.converged[failed]
        for array, values in zip(self.state.motion, before, strict=True):
            set_entries(array, worlds[failed[lost]], values[lost])
