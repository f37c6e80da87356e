"""The elastic body against closed forms that hold on every mesh."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.experiments.metrics import von_mises_stress
from defgrasp_ros.material import Material
from defgrasp_ros.validation.bodies import block, on_face
from defgrasp_ros.validation.case import Case, Experiment, relative, vanishing
from defgrasp_ros.validation.statics import ClampedBody

EXTENTS, CELLS = (0.06, 0.04, 0.04), (4, 3, 3)


def patch_test(device: str) -> Iterator[Case]:
    """A linear displacement of the boundary spreads exactly into an irregular mesh."""
    strain = 1e-6
    model = block(EXTENTS, CELLS, jittered=True)
    gradient = strain * np.random.default_rng(3).uniform(-1.0, 1.0, (3, 3))
    exact = model.mesh.vertices @ gradient.T
    boundary = np.isin(np.arange(len(exact)), model.mesh.surface_nodes)
    body = ClampedBody(model, np.repeat(boundary[:, None], 3, axis=1), device)
    found = body.balance(np.zeros_like(exact), given=exact)
    symmetric = 0.5 * (gradient + gradient.T)
    lame_lambda, lame_mu = model.material.lame_parameters
    stress = 2.0 * lame_mu * symmetric + lame_lambda * np.trace(symmetric) * np.eye(3)
    limit = 1e-5
    source = "linear field, constant stress; co-rotation is linear up to the strain (1e-6), ten times allowed"
    error = np.abs(found - exact).max() / np.abs(exact).max()
    yield vanishing("patch test: displacement inside, relative", error, limit, source)
    error = np.abs(body.stresses() - stress).max() / np.abs(stress).max()
    yield vanishing("patch test: stress, relative", error, limit, source)


def confined_compression(device: str) -> Iterator[Case]:
    """A block between six walls of which one moves in."""
    material, strain = Material(2e5, 0.3), 0.05
    model = block(EXTENTS, CELLS, material, jittered=True)
    walls = np.stack([on_face(model, axis, -1) | on_face(model, axis, 1) for axis in range(3)], axis=1)
    body = ClampedBody(model, walls, device)
    pushed = np.zeros(model.mesh.vertices.shape)
    pushed[on_face(model, 0, 1), 0] = -strain * EXTENTS[0]
    body.balance(np.zeros_like(pushed), given=pushed)
    nu, stress = material.poissons_ratio, body.stresses()
    modulus = material.youngs_modulus * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    source, limit = "exact on every mesh; solved to 1e-9", 1e-7
    along = "sigma = E (1 - nu) / ((1 + nu) (1 - 2 nu)) eps"
    yield relative(
        "confined compression: pressure [Pa]", -stress[:, 0, 0].mean(), modulus * strain, limit, f"{along}; {source}"
    )
    wall, expected = -stress[:, 1, 1].mean(), nu / (1.0 - nu) * modulus * strain
    yield relative(
        "confined compression: pressure on the walls [Pa]", wall, expected, limit, f"nu / (1 - nu) sigma; {source}"
    )


def large_stretch(device: str) -> Iterator[Case]:
    """A bar at nu = 0 pulled to 1.5 of its length and pressed to 0.7."""
    material = Material(2e5, 0.0)
    model = block(EXTENTS, CELLS, material, jittered=True)
    ends = on_face(model, 0, -1) | on_face(model, 0, 1)
    for stretch in (0.7, 1.5):
        body = ClampedBody(model, np.stack([ends, ends, ends], axis=1), device)
        given = model.mesh.vertices * [stretch - 1.0, 0.0, 0.0]
        body.balance(np.zeros_like(given), given=given)
        forces = body.elastic_forces(body.displacement)
        pull = -forces[on_face(model, 0, 1), 0].sum() / (EXTENTS[1] * EXTENTS[2])
        source = "co-rotated Hooke: force / first area = E (stretch - 1); exact on every mesh, solved to 1e-9"
        name = f"stretch to {stretch:g}: nominal stress [Pa]"
        yield relative(name, pull, material.youngs_modulus * (stretch - 1.0), 1e-7, source)


def rigid_rotation(device: str) -> Iterator[Case]:
    """A body turned as a whole carries no stress; a deformed one turned keeps its energy and turns its forces."""
    material, axis = Material(2e9), np.array([0.48, 0.6, 0.64])
    model = block(EXTENTS, CELLS, material, jittered=True)
    body = ClampedBody(model, np.zeros(model.mesh.vertices.shape, dtype=bool), device)
    bent = 0.05 * np.random.default_rng(6).uniform(-1.0, 1.0, (3, 3)) + np.eye(3)
    shape = model.mesh.vertices @ bent.T + 0.001 * np.sin(90.0 * model.mesh.vertices[:, ::-1])
    body.displacement = shape - model.mesh.vertices
    force, stress = body.elastic_forces(body.displacement), body.stresses()
    largest_stress = force_error = stress_error = 0.0
    for degrees in range(15, 181, 15):
        rotation = Rotation.from_rotvec(np.radians(degrees) * axis)
        body.displacement = rotation.apply(model.mesh.vertices) + [0.1, 0.2, 0.3] - model.mesh.vertices
        largest_stress = max(largest_stress, von_mises_stress(body.stresses()).max())
        body.displacement = rotation.apply(shape) - model.mesh.vertices
        difference = body.elastic_forces(body.displacement) - rotation.apply(force)
        force_error = max(force_error, np.abs(difference).max() / np.abs(force).max())
        stress_error = max(stress_error, np.abs(body.stresses() - stress).max() / np.abs(stress).max())
    source = "none; 1e4 roundings of double precision"
    name = "rigid rotation 0 to 180 deg at E = 2e9 Pa: largest stress / E"
    yield vanishing(name, largest_stress / material.youngs_modulus, 1e-12, source)
    source = "objectivity: f(Q x) = Q f(x); 1e4 roundings"
    yield vanishing("rotation of a deformed body: force, relative", force_error, 1e-11, source)
    yield vanishing("rotation of a deformed body: stress, relative", stress_error, 1e-11, source)


EXPERIMENTS = (
    Experiment("patch test", patch_test),
    Experiment("confined compression", confined_compression),
    Experiment("large stretch", large_stretch),
    Experiment("rigid rotation", rigid_rotation),
)
