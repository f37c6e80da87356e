"""A body in free space: it falls with g, keeps its momentum, and spins as a bar should."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.experiments.metrics import von_mises_stress
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import STANDARD_GRAVITY
from defgrasp_ros.simulation.rest_system import RestSystem
from defgrasp_ros.validation.bodies import block
from defgrasp_ros.validation.case import Case, Experiment, relative, vanishing
from defgrasp_ros.validation.rigs import WORLD, Rig, square_pads

STEP = 1.0 / 200.0
PADS = square_pads(0.01)


def free_fall(device: str) -> Iterator[Case]:
    """A soft block falls for 20 steps, turned by up to 180 degrees against its rest pose."""
    steps = 20
    model = block((0.03, 0.02, 0.02), (3, 2, 2), Material(2e4))
    for degrees in (0.0, 90.0, 180.0):
        rig = Rig(model, PADS, device)
        turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.48, 0.6, 0.64]))
        rig.simulator.set_displacement(WORLD, turn.apply(model.mesh.vertices) - model.mesh.vertices)
        rig.step(STEP, steps, quasi_static=False)
        expected = [0.0, 0.0, -STANDARD_GRAVITY * steps * STEP]
        error = np.abs(rig.simulator.velocities(WORLD)[0] - expected).max()
        name = f"free fall, turned by {degrees:g} deg"
        source = "v = g t for every node; a residual of 1e-6 m g on a single node in each step"
        limit = 1e-6 * STANDARD_GRAVITY * steps * STEP * len(model.mesh.vertices)
        yield vanishing(f"{name}: error of the velocity [m/s]", error, limit, source)
        stress = von_mises_stress(rig.simulator.stresses(WORLD)[0]).max()
        source = "none; 1e-6 m g on the smallest face of a cell"
        limit = 1e-6 * model.weight / 0.01**2
        yield vanishing(f"{name}: largest stress [Pa]", stress, limit, source)


def momentum(device: str) -> Iterator[Case]:
    """A block thrown with spin, and with a vibration.

    Implicit Euler keeps the linear momentum. It changes the angular momentum by h sum m v' x v in each step, whatever
    the internal forces are, if they obey action and reaction: with x' = x + h v' and sum x' x m (v' - v) = 0,
    sum m x' x v' = sum m x' x v = sum m x x v + h sum m v' x v.
    """
    h, steps = 1.0 / 1000.0, 200
    model = block((0.06, 0.03, 0.02), (4, 2, 2), Material(2e4, 0.3))
    mass = RestSystem(model).mass.diagonal()
    rig = Rig(model, PADS, device)
    rig.set_gravity(np.zeros(3))
    x = rig.positions()
    throw = np.array([0.1, -0.2, 0.3]) + np.cross([3.0, -8.0, 10.0], x) + 0.05 * np.sin(100.0 * x[:, ::-1])
    rig.simulator.set_velocity(WORLD, throw)
    linear, angular = mass @ throw, mass @ np.cross(x, throw)
    expected, v = angular.copy(), throw
    for _ in range(steps):
        rig.step(h, quasi_static=False)
        new = rig.simulator.velocities(WORLD)[0].copy()
        expected += h * (mass @ np.cross(new, v))
        v = new
    x = rig.positions()
    limit = steps * 1e-6 * model.weight * h * np.sqrt(len(mass))
    source = "conserved; a residual of 1e-6 m g at each node in each step"
    error = np.linalg.norm(mass @ v - linear)
    yield vanishing("thrown block: change of linear momentum [N s]", error, limit, source)
    error = np.linalg.norm(mass @ np.cross(x, v) - expected)
    arm = np.linalg.norm(x, axis=1).max()
    source = "implicit Euler: h sum m v' x v per step; the same residual on the longest arm"
    yield vanishing("thrown block: unexplained change of angular momentum [N m s]", error, limit * arm, source)


def spinning_bar(device: str) -> Iterator[Case]:
    """A bar that spins about its middle is stretched there by rho omega^2 L^2 / 8."""
    length, rate, h, steps = 0.1, 10.0, 1.0 / 2000.0, 200
    material = Material(2e6, 0.0)
    model = block((length, 0.01, 0.01), (20, 2, 2), material)
    rig = Rig(model, PADS, device)
    rig.set_gravity(np.zeros(3))
    x = model.mesh.vertices
    slope = material.density * rate**2 / (2.0 * material.youngs_modulus)
    stretch = slope * (length**2 / 4.0 * x[:, 0] - x[:, 0] ** 3 / 3.0)
    rig.simulator.set_displacement(WORLD, np.column_stack([stretch, 0.0 * stretch, 0.0 * stretch]))
    rig.simulator.set_velocity(WORLD, np.cross([0.0, 0.0, rate], x))
    rig.step(h, steps, quasi_static=False)
    mass, x, v = RestSystem(model).mass.diagonal(), rig.positions(), rig.simulator.velocities(WORLD)[0]
    slowed = (mass @ np.cross(x, v))[2] / (mass @ (x[:, :2] ** 2).sum(axis=1))
    along = model.mesh.vertices[model.mesh.tetrahedra][:, :, 0]
    middle = np.abs(along).max(axis=1) < 1.01 * length / 20
    stress = rig.simulator.stresses(WORLD)[0][0, middle, 0, 0] @ model.mesh.volumes[middle]
    expected = material.density * slowed**2 * length**2 / 8.0
    source = "rho omega^2 L^2 / 8 at the measured rate; 1 %: mean over the cells beside the middle, (2 / 20)^2"
    yield relative(
        "spinning bar: stress in the middle [Pa]", stress / model.mesh.volumes[middle].sum(), expected, 0.01, source
    )


EXPERIMENTS = (
    Experiment("free fall", free_fall),
    Experiment("momentum", momentum),
    Experiment("spinning bar", spinning_bar),
)
