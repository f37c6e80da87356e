"""The energy of a block that is squeezed, pulled along the pads and slides.

Work of the pads and of gravity = change of strain energy U and of kinetic energy T, heat of friction, and what implicit
Euler takes: sum 1/2 m |v' - v|^2 and, for small strains, 1/2 (u' - u)^T K (u' - u) in each step.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.validation.bodies import block
from defgrasp_ros.validation.case import Case, Experiment, relative
from defgrasp_ros.validation.rigs import ALONG_Y, WORLD, Rig, square_pads

EXTENTS, CELLS = (0.016, 0.02, 0.016), (3, 4, 3)
FORCE, FRICTION = 0.2, 0.5
DURATION = 0.04


class EnergyAccount:
    """What has come in and gone out since the start, updated after each step [J]."""

    def __init__(self, rig: Rig, gravity: np.ndarray):
        self.rig = rig
        self.gravity = gravity
        self.system = RestSystem(rig.model)
        self.work = self.heat = self.numerical = 0.0
        self._look()
        self.start = self.stored

    def _look(self) -> None:
        simulator = self.rig.simulator
        self.x, self.v = self.rig.positions().copy(), simulator.velocities(WORLD)[0].copy()
        self.opening = simulator.openings(WORLD)[0]
        self.stored = simulator.stresses(WORLD)[1].sum() + 0.5 * self.system.mass.diagonal() @ (self.v**2).sum(axis=1)

    def update(self) -> None:
        """Account for the step that was just taken."""
        x, v, opening = self.x, self.v, self.opening
        self._look()
        moved, mass = self.x - x, self.system.mass.diagonal()
        contact = self.rig.simulator.contact_forces(WORLD)[0]
        normal = np.einsum("ij,ij->i", contact.forces, contact.normals)
        tangential = contact.forces - normal[:, None] * contact.normals
        slip = np.einsum("ck,ckj->cj", contact.weights, moved[contact.nodes])
        self.work += -normal.sum() * (self.opening - opening) + self.gravity @ (mass @ moved)
        self.heat -= np.einsum("ij,ij->", tangential, slip)
        self.numerical += 0.5 * mass @ ((self.v - v) ** 2).sum(axis=1)
        self.numerical += 0.5 * moved.ravel() @ (self.system.stiffness @ moved.ravel())


def balance(device: str) -> Iterator[Case]:
    """Squeeze a block in dynamic steps and pull it along the pads; close the account at two step lengths.

    The pads are larger than the faces: the work of a sharp edge that wanders over the surface is not that of its
    normal force alone.
    """
    model = block(EXTENTS, CELLS, Material(2e4, 0.3, 1000.0, FRICTION))
    numerical = []
    for h in (1.0 / 500.0, 1.0 / 1000.0):
        gravity = np.array([0.0, 0.0, -1.2 * FRICTION * FORCE / model.mass])
        rig = Rig(model, square_pads(0.03), device)
        rig.set_gravity(gravity)
        rig.place_pads([ALONG_Y], FORCE, EXTENTS[1] / 2)
        account = EnergyAccount(rig, gravity)
        rig.watch = account.update
        for step in range(1, round(DURATION / h) + 1):
            rig.closing_force[:] = FORCE * min(1.0, 5.0 * step * h / DURATION)
            rig.step(h, quasi_static=False)
        spent = account.stored - account.start + account.heat + account.numerical
        numerical.append(account.numerical)
        source = "first law; 1e-3: the formula of the numerical loss neglects strains of some %"
        name = f"energy, steps of {1e3 * h:g} ms: stored + heat + numerical loss [J]"
        yield relative(name, spent, account.work, 1e-3, source)
    source = "implicit Euler loses in proportion to the step"
    yield relative("energy: numerical loss with half the step / loss", numerical[1] / numerical[0], 0.5, 0.2, source)


EXPERIMENTS = (Experiment("energy", balance),)
