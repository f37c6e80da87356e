"""The elastic body against closed forms and an independent finite element library."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import warp as wp
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from defgrasp_ros.experiments.metrics import von_mises_stress
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.kernels_element import polar_rotation
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.rest_system import RestSystem, rest_stiffness
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.simulation.types import mat33d

WORLD = np.array([0])
ORDERS = pytest.mark.parametrize("order", [1, 2])


@wp.kernel
def _polar(matrix: wp.array[mat33d], rotation: wp.array[mat33d]):
    i = wp.tid()
    rotation[i] = polar_rotation(matrix[i])


def jittered_block(order: int, youngs_modulus: float = 2e5, poissons_ratio: float = 0.3) -> ObjectModel:
    """A block whose inner nodes are moved, so that no element is special."""
    mesh = box((0.06, 0.04, 0.04), (4, 3, 3))
    inner = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.surface_nodes)
    vertices = mesh.vertices.copy()
    vertices[inner] += np.random.default_rng(0).uniform(-0.002, 0.002, (len(inner), 3))
    moved = TetMesh(vertices, mesh.tetrahedra, order)
    return ObjectModel("block", moved, Material(youngs_modulus=youngs_modulus, poissons_ratio=poissons_ratio))


def simulator_with(model: ObjectModel, displacement: np.ndarray) -> Simulator:
    """A simulator whose only world has the given nodal displacement."""
    simulator = Simulator(model, load_gripper(), 1)
    simulator.set_displacement(WORLD, displacement)
    return simulator


def test_polar_rotation_agrees_with_scipy():
    """Newton's iteration gives the polar factor to rounding; an inverted matrix still gives a rotation."""
    random = np.random.default_rng(5)
    matrices = Rotation.random(50, random_state=1).as_matrix() @ (np.eye(3) + 0.4 * random.uniform(-1, 1, (50, 3, 3)))
    source, target = wp.array(matrices, dtype=mat33d, device="cpu"), wp.zeros(50, dtype=mat33d, device="cpu")
    wp.launch(_polar, dim=50, inputs=[source], outputs=[target], device="cpu")
    for matrix, rotation in zip(matrices, target.numpy(), strict=True):
        assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-9)
        if np.linalg.det(matrix) > 1e-2:
            np.testing.assert_allclose(rotation, scipy.linalg.polar(matrix)[0], atol=1e-12)


@ORDERS
def test_stiffness_agrees_with_an_independent_library(order):
    """The rest stiffness equals scikit-fem's linear elasticity on the same mesh."""
    skfem = pytest.importorskip("skfem")
    from skfem.models.elasticity import linear_elasticity

    model = jittered_block(order)
    mesh = model.mesh
    element = {1: skfem.ElementTetP1, 2: skfem.ElementTetP2}[order]()
    corners = mesh.vertices[: mesh.tetrahedra.max() + 1]
    basis = skfem.Basis(skfem.MeshTet(corners.T, mesh.tetrahedra.T), skfem.ElementVector(element))
    reference = linear_elasticity(*model.material.lame_parameters).assemble(basis).toarray()
    distance, entry = cKDTree(basis.doflocs.T[::3]).query(mesh.vertices)
    assert distance.max() < 1e-12
    dofs = (3 * entry[:, None] + np.arange(3)).ravel()
    ours = rest_stiffness(model).toarray()
    np.testing.assert_allclose(ours, reference[np.ix_(dofs, dofs)], atol=1e-10 * np.abs(ours).max())


@ORDERS
def test_compliance_is_the_inverse(order):
    """P (M / h^2 + K) is the identity, and its rigid part moves the body by h^2 / m."""
    model = jittered_block(order, 2e9)
    system, h = RestSystem(model), 0.005
    mass = np.kron(system.mass.toarray(), np.eye(3))
    matrix = system.stiffness.toarray() + mass / h**2
    compliance = system.compliance(h)
    np.testing.assert_allclose(compliance.matrix @ matrix, np.eye(len(matrix)), atol=1e-6)
    push = mass @ np.tile([1.0, 0.0, 0.0], len(model.mesh.vertices)) / model.mass
    np.testing.assert_allclose((compliance.matrix @ push)[::3], h**2 / model.mass, rtol=1e-6)
    assert (compliance.elastic > 0.0).all()


@ORDERS
def test_patch(order):
    """A linear displacement gives the same, exact stress in every element and no net force inside."""
    model = jittered_block(order)
    gradient = 1e-6 * np.random.default_rng(3).uniform(-1, 1, (3, 3))
    simulator = simulator_with(model, model.mesh.vertices @ gradient.T)
    stress, _ = simulator.stresses(WORLD)
    strain = 0.5 * (gradient + gradient.T)
    lame_lambda, lame_mu = model.material.lame_parameters
    expected = 2 * lame_mu * strain + lame_lambda * np.trace(strain) * np.eye(3)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(stress[0], np.broadcast_to(expected, stress[0].shape), atol=1e-5 * scale)
    forces = simulator.elastic_forces(WORLD)[0]
    inner = np.setdiff1d(np.arange(len(forces)), model.mesh.surface_nodes)
    assert np.abs(forces[inner]).max() < 1e-6 * np.abs(forces).max()


def test_quadratic_displacement():
    """Elements of order 2 hold a quadratic displacement: stress at every point, and its energy, are exact."""
    model = jittered_block(2)
    mesh, (lame_lambda, lame_mu) = model.mesh, model.material.lame_parameters
    linear, curved = 1e-6 * np.random.default_rng(8).uniform(-1, 1, (2, 3, 3))
    curved *= 100.0

    def displacement(x: np.ndarray) -> np.ndarray:
        return x @ linear.T + np.stack([x[:, 0] * x[:, 1], x[:, 1] ** 2, x[:, 2] * x[:, 0]], axis=1) @ curved.T

    def gradient(x: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(x, -1, 0)
        zero = np.zeros_like(x)
        inner = np.array([[y, x, zero], [zero, 2.0 * y, zero], [z, zero, x]])
        return linear + np.einsum("ij,jk...->...ik", curved, inner)

    simulator = simulator_with(model, displacement(mesh.vertices))
    stress, energy = simulator.point_stresses(WORLD)
    places = REFERENCE_ELEMENTS[2].points @ mesh.vertices[mesh.tetrahedra]
    h = gradient(places)
    strain = 0.5 * (h + np.swapaxes(h, -1, -2))
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    expected = 2.0 * lame_mu * strain + lame_lambda * trace * np.eye(3)
    np.testing.assert_allclose(stress[0], expected, atol=1e-4 * np.abs(expected).max())
    stiffness = rest_stiffness(model)
    u = displacement(mesh.vertices).ravel()
    assert energy.sum() == pytest.approx(0.5 * u @ stiffness @ u, rel=1e-4)


@ORDERS
def test_force_is_the_gradient_of_the_energy(order):
    """A small motion of the nodes changes the strain energy by minus force times motion, at large rotations too."""
    model = jittered_block(order)
    turned = Rotation.from_rotvec([0.4, -0.9, 0.5]).apply(model.mesh.vertices)
    random = np.random.default_rng(7)
    u = turned - model.mesh.vertices + 1e-3 * np.sin(80.0 * model.mesh.vertices[:, ::-1])
    motion = 1e-7 * random.uniform(-1, 1, u.shape)
    force = simulator_with(model, u).elastic_forces(WORLD)[0]
    energies = [simulator_with(model, u + sign * motion).stresses(WORLD)[1].sum() for sign in (-1.0, 1.0)]
    assert (energies[1] - energies[0]) / 2.0 == pytest.approx(-(force * motion).sum(), rel=1e-6)


@pytest.mark.parametrize(("order", "cells", "tolerance"), [(1, (9, 6, 6), 0.04), (2, (4, 3, 3), 0.0105)])
def test_natural_frequencies_of_a_free_block(order, cells, tolerance):
    """Mass and rest stiffness give the first seven modes of a free 60 x 40 x 40 mm block, with some 450 nodes.

    Reference: f L / c0 at nu = 0.3 by Ritz's method with Legendre polynomials of degree 12. The tolerance is the
    largest error of such a mesh; docs/element_order.md shows how it falls with refinement.
    """
    reference = np.array([0.28390, 0.36346, 0.36346, 0.46718, 0.47867, 0.47951, 0.47951])
    model = ObjectModel("block", replace(box((0.06, 0.04, 0.04), cells), element_order=order), Material(2e5))
    system = RestSystem(model)
    assert system.mass.sum() == pytest.approx(model.mass, rel=1e-12)
    mass = np.kron(system.mass.toarray(), np.eye(3))
    squares = scipy.linalg.eigh(system.stiffness.toarray(), mass, eigvals_only=True, subset_by_index=[0, 12])
    frequency = np.sqrt(squares[6:]) / (2.0 * np.pi)
    wave_speed = np.sqrt(model.material.youngs_modulus / model.material.density)
    assert np.abs(squares[:6]).max() < 1e-9 * squares[6]
    np.testing.assert_allclose(frequency * 0.06 / wave_speed, reference, rtol=tolerance)


@ORDERS
def test_rigid_part_of_the_compliance(order):
    """What a free body's compliance keeps once its rigid modes are taken away is elastic: it does not grow as h^2."""
    system = RestSystem(jittered_block(order))
    slow, slower = (system.compliance(h).elastic for h in (1.0, 2.0))
    np.testing.assert_allclose(slow, slower, rtol=1e-3)


@ORDERS
@pytest.mark.parametrize("angle", [0.1, 1.0, 3.0])
def test_rigid_rotation_gives_no_stress(order, angle):
    """A body turned and moved as a whole carries no stress and no force, at the stiffest modulus too."""
    model = jittered_block(order, 2e9)
    turned = Rotation.from_rotvec([0.0, 0.6 * angle, 0.8 * angle]).apply(model.mesh.vertices) + [0.1, 0.2, 0.3]
    simulator = simulator_with(model, turned - model.mesh.vertices)
    stress, _ = simulator.stresses(WORLD)
    assert von_mises_stress(stress).max() < 1e-12 * 2e9
    assert np.abs(simulator.elastic_forces(WORLD)).max() < 1e-12 * 2e9 * 0.04**2


@ORDERS
def test_forces_turn_with_the_body(order):
    """Turning a deformed body turns its forces and keeps its energy."""
    model = jittered_block(order)
    bent = 0.05 * np.random.default_rng(6).uniform(-1, 1, (3, 3)) + np.eye(3)
    shape = model.mesh.vertices @ bent.T + 0.001 * np.sin(90.0 * model.mesh.vertices[:, ::-1])
    rotation = Rotation.from_rotvec([1.0, -0.5, 0.3])
    before = simulator_with(model, shape - model.mesh.vertices)
    after = simulator_with(model, rotation.apply(shape) - model.mesh.vertices)
    force = before.elastic_forces(WORLD)[0]
    np.testing.assert_allclose(after.elastic_forces(WORLD)[0], rotation.apply(force), atol=1e-12 * np.abs(force).max())
    assert after.stresses(WORLD)[1].sum() == pytest.approx(before.stresses(WORLD)[1].sum(), rel=1e-12)


@ORDERS
def test_force_along_one_axis_is_linear_in_the_stretch(order):
    """Co-rotated Hooke at nu = 0: nominal stress E (stretch - 1) at any stretch."""
    model = jittered_block(order, poissons_ratio=0.0)
    for stretch in (0.3, 0.7, 1.5):
        simulator = simulator_with(model, model.mesh.vertices * [stretch - 1.0, 0.0, 0.0])
        forces = simulator.elastic_forces(WORLD)[0]
        end = model.mesh.vertices[:, 0] > 0.0299
        pull = -forces[end, 0].sum() / (0.04 * 0.04)
        assert pull == pytest.approx(2e5 * (stretch - 1.0), rel=1e-9)
