"""Natural frequencies of free blocks, and how implicit Euler lets a vibration ring.

A mode of circular frequency w decays in implicit Euler by 1 / sqrt(1 + (w h)^2) per step and turns by atan(w h).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import eigsh

from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.validation.bodies import block, extrapolated
from defgrasp_ros.validation.case import Case, Experiment, relative
from defgrasp_ros.validation.rigs import WORLD, Rig

BLOCK = (0.06, 0.04, 0.04), (0.28390, 0.36346, 0.36346, 0.46718)
BEAM = (0.1, 0.02, 0.02), (0.18229, 0.18229, 0.28476)
"""Extents [m], and f L / sqrt(E / density) of the lowest elastic modes at nu = 0.3."""


def modes(model: ObjectModel, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest elastic modes of the free body: circular frequencies [rad/s] and shapes, ``(3 node, mode)``."""
    system = RestSystem(model)
    mass = np.repeat(system.mass.diagonal(), 3)
    scale = scipy.sparse.diags(1.0 / np.sqrt(mass))
    matrix = (scale @ system.stiffness @ scale).tocsc()
    shift = -1e-2 * model.material.youngs_modulus / (model.material.density * model.mesh.size**2)
    squares, shapes = eigsh(matrix, k=6 + count, sigma=shift, v0=np.ones(len(mass)))
    order = np.argsort(squares)[6:]
    return np.sqrt(squares[order]), (scale @ shapes)[:, order]


def frequencies(device: str, body: tuple, name: str, cells: tuple[int, int, int]) -> Iterator[Case]:
    """Frequencies of two meshes, extrapolated, against a Ritz solution."""
    extents, expected = body
    material = Material(2e5, 0.3)
    speed = math.sqrt(material.youngs_modulus / material.density)
    found = [modes(block(extents, tuple(factor * n for n in cells), material), len(expected))[0] for factor in (1, 2)]
    limit = [extrapolated(*pair) * extents[0] / (2.0 * math.pi * speed) for pair in zip(*found, strict=True)]
    source = "Ritz, Legendre polynomials of degree 12; extrapolated from 4 and 8 cells high; 2 %: terms above h^2"
    for number, (value, reference) in enumerate(zip(limit, expected, strict=True), start=1):
        yield relative(f"{name}, mode {number}: f L / sqrt(E / density)", value, reference, 0.02, source)


def ringing(device: str) -> Iterator[Case]:
    """The first mode of a block, started with a small amplitude: the steps must decay and turn as theory says."""
    material, steps, amplitude = Material(2e5, 0.3), 100, 1e-5
    model = block(BLOCK[0], (6, 4, 4), material)
    (frequency,), shape = modes(model, 1)
    mass = np.repeat(RestSystem(model).mass.diagonal(), 3)
    h = 0.1 / frequency
    rig = Rig(model, load_gripper(), device)
    rig.set_gravity(np.zeros(3))
    shape = amplitude * shape[:, 0] / np.abs(shape).max()
    rig.simulator.set_displacement(WORLD, shape.reshape(-1, 3))
    rig.step(h, steps, quasi_static=False)
    displacement = (rig.positions() - model.mesh.vertices).ravel()
    velocity = rig.simulator.velocities(WORLD)[0].ravel()
    norm = shape @ (mass * shape)
    # Implicit Euler in z = u + i v / w: z' = z / (1 + i w h).
    found = complex(displacement @ (mass * shape), velocity @ (mass * shape) / frequency) / norm
    exact = (1.0 + 0.1j) ** -steps
    source = "implicit Euler: (1 + i w h)^-n, w h = 0.1, n = 100; 1e-3: a hundred residuals of 1e-6 m g add up"
    yield relative("ringing block: amplitude after 100 steps", abs(found), abs(exact), 1e-3, source)
    turn = np.angle(found / exact) + 100.0 * math.atan(0.1)
    yield relative("ringing block: phase after 100 steps [rad]", turn, 100.0 * math.atan(0.1), 1e-3, source)


EXPERIMENTS = (
    Experiment("frequencies, block", partial(frequencies, body=BLOCK, name="free block", cells=(6, 4, 4))),
    Experiment(
        "frequencies, beam",
        partial(frequencies, body=BEAM, name="free beam", cells=(20, 4, 4)),
        quick=False,
    ),
    Experiment("ringing", ringing),
)
