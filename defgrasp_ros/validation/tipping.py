"""A tall block topples where rigid statics says: when its weight points outside of its base."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.object_model import STANDARD_GRAVITY
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.validation.bodies import block, on_face
from defgrasp_ros.validation.case import Case, Experiment, relative
from defgrasp_ros.validation.rigs import Rig, square_pads

STEP = 1.0 / 200.0
WIDTH, HEIGHT = 0.01, 0.03
LEVELS = np.array([0.98, 0.99, 1.01, 1.02])
"""Slopes, relative to width / height [-]."""


def tipping(device: str) -> Iterator[Case]:
    """Stiff blocks on slopes around the one at which they topple, one world for each."""
    model = block((WIDTH, WIDTH, HEIGHT), (2, 2, 6), Material(2e9, 0.3, 1000.0, 0.7))
    tilts = np.arctan(LEVELS * WIDTH / HEIGHT)
    rig = Rig(model, square_pads(0.01), device, len(LEVELS))
    rig.put_on_platform()
    rig.step(STEP, 5, quasi_static=True)
    rig.set_gravity(STANDARD_GRAVITY * np.column_stack([np.sin(tilts), 0.0 * tilts, -np.cos(tilts)]))
    start, top = rig.simulator.positions(rig.every), on_face(model, 2, 1)
    rig.step(STEP, quasi_static=False)
    first_angle = rig.shifts(top, start)[-1, 0] / HEIGHT
    rig.step(STEP, 10, quasi_static=False)
    angle = rig.shifts(top, start)[:, 0] / HEIGHT
    topples = angle > 1e-6
    first = int(np.argmax(topples))
    bracketed = first > 0 and topples[first:].all()
    slope = 0.5 * (LEVELS[first - 1] + LEVELS[first]) * WIDTH / HEIGHT if bracketed else math.nan
    source = "width / height; bracketed by slopes of " + ", ".join(f"{level:g}" for level in LEVELS) + " of it"
    yield relative("block on a slope: tan of the angle at which it topples", slope, WIDTH / HEIGHT, 0.02, source)
    mass = RestSystem(model).mass.diagonal()
    arm = model.mesh.vertices - [WIDTH / 2, 0.0, -HEIGHT / 2]
    inertia = mass @ (arm[:, 0] ** 2 + arm[:, 2] ** 2)
    torque = model.weight * (HEIGHT / 2 * math.sin(tilts[-1]) - WIDTH / 2 * math.cos(tilts[-1]))
    source = "rigid body about its edge, first step; the torque grows by 1 % within it, as the weight leans out"
    name = "block on a slope: angular acceleration at 1.02 [rad/s^2]"
    yield relative(name, first_angle / STEP**2, torque / inertia, 0.02, source)


EXPERIMENTS = (Experiment("tipping", tipping),)
