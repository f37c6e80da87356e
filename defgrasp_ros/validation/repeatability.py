"""The same world alone and among others, twice, and on another device."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.simulation.kernels_progress import TOLERANCE
from defgrasp_ros.validation.bodies import block
from defgrasp_ros.validation.case import Case, Experiment, vanishing
from defgrasp_ros.validation.rigs import Rig, square_pads

STEP = 1.0 / 200.0
EXTENTS, CELLS = (0.016, 0.02, 0.016), (3, 4, 3)
FORCE = 0.2
PULL = 0.06
"""Below the friction limit of 0.14 N [N]."""
GRASP = Grasp(np.array([0.0003, 0.0, 0.0005]), np.array([0.0, np.sin(0.15), 0.0, np.cos(0.15)]))
"""Turned and shifted a little: where a pad's corner lies on an edge of the mesh, rounding chooses contact points."""


def held_block(device: str, worlds: int) -> Rig:
    """A block that is squeezed and pulled; the worlds beside the first are pulled otherwise."""
    model = block(EXTENTS, CELLS, Material(2e5))
    rig = Rig(model, square_pads(0.006), device, worlds)
    rig.set_gravity(np.zeros(3))
    rig.place_pads([GRASP] * worlds, FORCE, EXTENTS[1] / 2)
    rig.squeeze(FORCE, STEP, 20)
    directions = np.array([[0.0, 0.0, -1.0], [0.8, 0.0, 0.6], [2.0, 0.0, 0.0]])[:worlds]
    rig.set_gravity(PULL / model.mass * directions)
    rig.step(STEP, 20, quasi_static=False)
    return rig


def largest_difference(one: Rig, other: Rig) -> float:
    """Between the displacements of the first worlds, relative to the largest."""
    displacement = one.positions() - one.model.mesh.vertices
    return float(np.abs(one.positions() - other.positions()).max() / np.abs(displacement).max())


def repeated(device: str) -> Iterator[Case]:
    """Two equal runs."""
    difference = largest_difference(held_block(device, 1), held_block(device, 1))
    source = "itself: sums in a fixed order give equal bits"
    yield vanishing("same run twice: largest difference, relative", difference, 0.0, source)


def in_a_batch(device: str) -> Iterator[Case]:
    """One world alone and beside two that are loaded otherwise."""
    difference = largest_difference(held_block(device, 1), held_block(device, 3))
    source = "itself; a residual of 1e-6 of the force, as products of matrices round differently in a batch"
    yield vanishing("alone and in a batch: largest difference, relative", difference, 10.0 * TOLERANCE, source)


def on_cuda(device: str) -> Iterator[Case]:
    """The same worlds on the CPU and on a CUDA device."""
    cuda = device if device.startswith("cuda") else "cuda:0"
    difference = largest_difference(held_block("cpu", 3), held_block(cuda, 3))
    source = "the CPU; a residual of 1e-6 of the force, as sums round differently"
    yield vanishing(f"CPU and {cuda}: largest difference, relative", difference, 10.0 * TOLERANCE, source)


EXPERIMENTS = (
    Experiment("same run twice", repeated),
    Experiment("alone and in a batch", in_a_batch),
    Experiment("CPU and CUDA", on_cuda, compares_devices=True),
)
