"""Cantilevers: small deflection against Timoshenko's beam, large deflection against the elastica.

Linear tetrahedra are too stiff in bending ("locking") by an amount that falls with the square of the cell: one third
with two cells through the height, a tenth with four. So the rate and the limit are checked, not a coarse value; and
the elastica is scaled by the bending stiffness that the same mesh shows under a small load.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.validation.bodies import block, extrapolated, on_face
from defgrasp_ros.validation.case import Case, Experiment, absolute, relative
from defgrasp_ros.validation.statics import ClampedBody

ELASTICA = {  # F L^2 / EI: drop / L, shortening / L
    0.5: (0.16214, 0.01592),
    1.0: (0.30172, 0.05643),
    2.0: (0.49346, 0.16064),
    3.0: (0.60325, 0.25442),
    5.0: (0.71379, 0.38763),
    10.0: (0.81061, 0.55500),
}
"""Tip of a cantilever under a transverse load (Bisshopp and Drucker 1945)."""


class Cantilever:
    """A beam along x, clamped at its smallest x, loaded at the other end across."""

    def __init__(self, length: float, height: float, cells: int, material: Material, device: str):
        along = round(cells * length / height)
        model = block((length, height, height), (along, cells, cells), material)
        self.body = ClampedBody(model, np.repeat(on_face(model, 0, -1)[:, None], 3, axis=1), device)
        self.tip = on_face(model, 0, 1)

    def tip_displacement(self, force: float) -> np.ndarray:
        """Mean displacement of the tip's face under a force in -z [m], shape ``(3,)``."""
        load = np.zeros((len(self.tip), 3))
        load[self.tip, 2] = -force / self.tip.sum()
        return self.body.balance(load)[self.tip].mean(axis=0)


def small_deflection(device: str, cells: tuple[int, int, int]) -> Iterator[Case]:
    """Three meshes: order of convergence, and the limit of the two finest.

    At nu = 0, where the clamp does not hinder the root from getting wider as the beam of the theory does.
    """
    material, length, height, force = Material(2e5, 0.0), 0.2, 0.02, 1e-4
    area, inertia, shear_factor = height**2, height**4 / 12.0, 10.0 / 12.0
    bending = length**3 / (3.0 * material.youngs_modulus * inertia)
    expected = 1.0 / (bending + length / (material.lame_parameters[1] * shear_factor * area))
    stiffness = [force / -Cantilever(length, height, n, material, device).tip_displacement(force)[2] for n in cells]
    errors = [abs(value / expected - 1.0) for value in stiffness]
    order = math.log(errors[0] / errors[-1]) / math.log(cells[-1] / cells[0])
    name = f"cantilever, {' '.join(str(n) for n in cells)} cells high"
    source = "linear tetrahedra: the error falls with h^2; 0.1: terms above h^2"
    yield absolute(f"{name}: order of convergence", order, 2.0, 0.1, source)
    limit = extrapolated(stiffness[-2], stiffness[-1], cells[-1] / cells[-2])
    source = "Timoshenko, L / h = 10; extrapolated; 0.5 %: terms above h^2, and the load on the tip's nodes alike"
    yield relative(f"{name}: limit of the stiffness [N/m]", limit, expected, 0.005, source)


def large_deflection(device: str, cells: int) -> Iterator[Case]:
    """Drop and shortening of a slender beam up to a slope of 82 degrees at its tip."""
    length, height = 0.2, 0.01
    beam = Cantilever(length, height, cells, Material(2e5, 0.0), device)
    unit = 1e-5
    bending_stiffness = unit * length**3 / (3.0 * -beam.tip_displacement(unit)[2])
    source = "Bisshopp and Drucker 1945, EI as under a small load; 1 %: L / h = 20 also shears and stretches, (h / L)^2"
    for load, (drop, shortening) in ELASTICA.items():
        tip = beam.tip_displacement(load * bending_stiffness / length**2)
        name = f"elastica, F L^2 / EI = {load:g}"
        yield relative(f"{name}: drop / L", -tip[2] / length, drop, 0.01, source)
        yield relative(f"{name}: shortening / L", -tip[0] / length, shortening, 0.01, source)


EXPERIMENTS = (
    Experiment("cantilever", partial(small_deflection, cells=(2, 3, 4))),
    Experiment("cantilever, fine", partial(small_deflection, cells=(4, 6, 8)), quick=False),
    Experiment("elastica", partial(large_deflection, cells=2)),
)
