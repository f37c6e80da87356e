"""The laws of contact, point by point and step by step, while a block is squeezed, pulled and slides."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.simulation.kernels_progress import TOLERANCE
from defgrasp_ros.validation.bodies import block
from defgrasp_ros.validation.case import Case, Experiment, vanishing
from defgrasp_ros.validation.rigs import ALONG_Y, WORLD, Rig, square_pads

STEP = 1.0 / 200.0
EXTENTS, CELLS = (0.016, 0.02, 0.016), (4, 5, 4)
FORCE, FRICTION = 0.2, 0.5


class Violations:
    """The worst that was seen since the start."""

    def __init__(self, rig: Rig):
        self.rig = rig
        self.penetration = self.gap = self.cone = self.slip = self.direction = 0.0
        self.positions = rig.positions()

    def look(self) -> None:
        """Check the step that was just taken."""
        simulator = self.rig.simulator
        before, self.positions = self.positions, self.rig.positions()
        self.penetration = max(self.penetration, -simulator.pad_gaps(WORLD).min())
        contact = simulator.contact_forces(WORLD)[0]
        normal = np.einsum("ij,ij->i", contact.forces, contact.normals)
        tangential = contact.forces - normal[:, None] * contact.normals
        friction = np.linalg.norm(tangential, axis=1)
        gap = np.einsum("ij,ij->i", contact.positions, contact.normals) + simulator.openings(WORLD)[0]
        moved = np.einsum("ck,ckj->cj", contact.weights, (self.positions - before)[contact.nodes])
        moved -= np.einsum("ij,ij->i", moved, contact.normals)[:, None] * contact.normals
        distance = np.linalg.norm(moved, axis=1)
        against = distance * friction + np.einsum("ij,ij->i", moved, tangential)
        sticks = friction < FRICTION * normal - 1e-5 * FORCE
        self.gap = max(self.gap, np.abs(gap).max(initial=0.0))
        self.cone = max(self.cone, (friction - FRICTION * normal).max(initial=0.0) / FORCE)
        self.slip = max(self.slip, distance[sticks].max(initial=0.0))
        self.direction = max(self.direction, (against / np.maximum(friction, 1e-5 * FORCE)).max(initial=0.0))


def laws(device: str, youngs_modulus: float) -> Iterator[Case]:
    """Look at every step of a squeeze, a pull below the limit and one beyond it."""
    model = block(EXTENTS, CELLS, Material(youngs_modulus, 0.3, 1000.0, FRICTION))
    rig = Rig(model, square_pads(0.006), device)
    rig.set_gravity(np.zeros(3))
    rig.place_pads([ALONG_Y], FORCE, EXTENTS[1] / 2)
    violations = Violations(rig)
    rig.watch = violations.look
    rig.squeeze(FORCE, STEP, 20)
    for share in (0.5, 0.9, 1.1):
        rig.set_gravity(share * FRICTION * FORCE / model.mass * np.array([0.6, 0.0, -0.8]))
        rig.step(STEP, 10, quasi_static=True)
    name = f"laws of contact, E = {youngs_modulus:.0e} Pa".replace("e+0", "e")
    cell = EXTENTS[0] / CELLS[0]
    residual = TOLERANCE * FORCE / (youngs_modulus * cell)
    source = "none; 1e-4 of the body's size: an edge may cross the pad's outline 2 % of it beside the contact point"
    limit = 1e-4 * model.mesh.size
    yield vanishing(f"{name}: deepest point inside a pad [m]", violations.penetration, limit, source)
    source = "zero where there is force; residual of 1e-6 of the force on ten times a cell's compliance"
    yield vanishing(f"{name}: gap at a loaded point [m]", violations.gap, 10.0 * residual, source)
    yield vanishing(f"{name}: friction beyond mu N, relative", violations.cone, TOLERANCE, "Coulomb; residual of 1e-6")
    source = "sticks where friction is below mu N; residual as for the gap"
    yield vanishing(f"{name}: slip of a sticking point in a step [m]", violations.slip, 10.0 * residual, source)
    source = "opposite to friction; residual as for the gap"
    yield vanishing(f"{name}: slip not against friction [m]", violations.direction, 10.0 * residual, source)


EXPERIMENTS = tuple(
    Experiment(f"laws of contact, E = {modulus:g} Pa", partial(laws, youngs_modulus=modulus), quick=modulus == 2e5)
    for modulus in (2e4, 2e5, 2e6, 2e9)
)
