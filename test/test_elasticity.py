"""The elastic body against closed forms and an independent finite element library."""

import numpy as np
import pytest
import scipy.linalg
import warp as wp
from scipy.spatial.transform import Rotation

from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.kernels_elasticity import polar_rotation
from defgrasp_ros.simulation.rest_system import RestSystem, rest_stiffness
from defgrasp_ros.simulation.types import mat33d

WORLD = np.array([0])


@wp.kernel
def _polar(matrix: wp.array[mat33d], rotation: wp.array[mat33d]):
    i = wp.tid()
    rotation[i] = polar_rotation(matrix[i])


def jittered_block(youngs_modulus: float = 2e5, poissons_ratio: float = 0.3) -> ObjectModel:
    """A block whose inner nodes are moved, so that no element is special."""
    mesh = box((0.06, 0.04, 0.04), (4, 3, 3))
    inner = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.surface_nodes)
    vertices = mesh.vertices.copy()
    vertices[inner] += np.random.default_rng(0).uniform(-0.002, 0.002, (len(inner), 3))
    moved = type(mesh)(vertices, mesh.tetrahedra)
    return ObjectModel("block", moved, Material(youngs_modulus=youngs_modulus, poissons_ratio=poissons_ratio))


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


def test_stiffness_agrees_with_an_independent_library():
    """The rest stiffness equals scikit-fem's linear elasticity on the same mesh."""
    skfem = pytest.importorskip("skfem")
    from skfem.models.elasticity import linear_elasticity

    model = jittered_block()
    basis = skfem.Basis(
        skfem.MeshTet(model.mesh.vertices.T, model.mesh.tetrahedra.T), skfem.ElementVector(skfem.ElementTetP1())
    )
    reference = linear_elasticity(*model.material.lame_parameters).assemble(basis).toarray()
    order = basis.nodal_dofs.T.ravel()
    ours = rest_stiffness(model).toarray()
    np.testing.assert_allclose(ours, reference[np.ix_(order, order)], atol=1e-10 * np.abs(ours).max())


def test_compliance_is_the_inverse():
    """P (M / h^2 + K) is the identity, and its rigid part moves the body by h^2 / m."""
    model = jittered_block(2e9)
    system, h = RestSystem(model), 0.005
    matrix = system.stiffness.toarray() + np.diag(np.repeat(system.mass, 3)) / h**2
    compliance = system.compliance(h)
    np.testing.assert_allclose(compliance.matrix @ matrix, np.eye(len(matrix)), atol=1e-6)
    push = np.tile([1.0, 0.0, 0.0], len(system.mass)) * np.repeat(system.mass, 3) / model.mass
    np.testing.assert_allclose((compliance.matrix @ push)[::3], h**2 / model.mass, rtol=1e-6)
    assert (compliance.elastic > 0.0).all()
