"""What follows from the geometry of a tetrahedral mesh."""

from dataclasses import replace

import numpy as np
import pytest

from defgrasp_ros.errors import InvalidMeshError
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TET_EDGES, TetMesh, signed_volumes

UNIT_CORNER = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.fixture
def block():
    return box([0.06, 0.04, 0.02], (3, 2, 2))


def test_negative_elements_are_turned():
    """An element of either orientation ends up with positive volume and the same corners."""
    for order in ([0, 1, 2, 3], [0, 2, 1, 3]):
        mesh = TetMesh(UNIT_CORNER, [order])
        assert mesh.volumes == pytest.approx([1.0 / 6.0])
        assert sorted(mesh.tetrahedra[0]) == [0, 1, 2, 3]
    assert signed_volumes(np.array(UNIT_CORNER), np.array([[0, 2, 1, 3]])) == pytest.approx([-1.0 / 6.0])


def test_unused_vertices_are_dropped():
    """A vertex of no element would be a free mass; indices follow."""
    mesh = TetMesh([[9.0, 9.0, 9.0], *UNIT_CORNER], [[1, 2, 3, 4]])
    np.testing.assert_array_equal(mesh.vertices, UNIT_CORNER)
    assert sorted(mesh.tetrahedra[0]) == [0, 1, 2, 3]


def test_surface_is_closed_and_points_outwards(block):
    """The divergence theorem over the boundary gives the volume, and its area vectors sum to zero."""
    a, b, c = np.moveaxis(block.vertices[block.surface_triangles], 1, 0)
    area_vectors = np.cross(b - a, c - a) / 2.0
    np.testing.assert_allclose(area_vectors.sum(axis=0), 0.0, atol=1e-18)
    assert np.einsum("ij,ij->", (a + b + c) / 3.0, area_vectors) / 3.0 == pytest.approx(block.volume, rel=1e-12)


def test_surface_satisfies_eulers_formula(block):
    """Vertices - edges + faces = 2 on a body without holes; inner nodes are not on the surface."""
    assert len(block.surface_nodes) - len(block.surface_edges) + len(block.surface_triangles) == 2
    inside = np.setdiff1d(np.arange(len(block.vertices)), block.surface_nodes)
    assert len(inside) == 2 * 1 * 1
    assert (np.abs(block.vertices[inside]) < block.extents / 2.0 - 1e-6).all()


def test_shape_gradients_reproduce_a_linear_field(block):
    """The gradient of u = A x + b is A in every element, and gradients sum to zero over an element."""
    gradient = np.array([[0.3, -1.0, 2.0], [0.5, 0.1, 0.0], [-0.7, 4.0, 1.0]])
    displacement = block.vertices @ gradient.T + [1.0, 2.0, 3.0]
    computed = np.einsum("tai,taj->tij", displacement[block.tetrahedra], block.shape_gradients)
    np.testing.assert_allclose(computed, np.broadcast_to(gradient, computed.shape), atol=1e-10)
    np.testing.assert_allclose(block.shape_gradients.sum(axis=1), 0.0, atol=1e-9)


def test_volumes_and_extents(block):
    """Node volumes share out the whole volume; extents and size are those of the bounding box."""
    assert block.volume == pytest.approx(0.06 * 0.04 * 0.02)
    assert block.node_volumes.sum() == pytest.approx(block.volume)
    np.testing.assert_allclose(block.extents, [0.06, 0.04, 0.02])
    assert block.size == pytest.approx(np.sqrt(0.06**2 + 0.04**2 + 0.02**2))


@pytest.mark.parametrize(
    "vertices, tetrahedra, words",
    [
        (np.zeros((4, 2)), [[0, 1, 2, 3]], ["vertices", "(4, 2)"]),
        (UNIT_CORNER, [[0, 1, 2]], ["tetrahedra", "(1, 3)"]),
        (UNIT_CORNER, np.zeros((0, 4), int), ["(0, 4)", "at least one"]),
        ([*UNIT_CORNER[:3], [0.0, 0.0, np.inf]], [[0, 1, 2, 3]], ["vertex 3", "finite"]),
        (UNIT_CORNER, [[0, 1, 2, 4]], ["index 4", "4 vertices"]),
        (UNIT_CORNER, [[0, 1, 2, -1]], ["index -1"]),
        (UNIT_CORNER, [[0, 1, 2, 3], [0, 1, 2, 2]], ["1 of 2", "no volume", "element 1"]),
    ],
)
def test_faults_are_named(vertices, tetrahedra, words):
    """The error says which array, index or element is wrong."""
    with pytest.raises(InvalidMeshError) as caught:
        TetMesh(vertices, tetrahedra)
    for word in words:
        assert word in str(caught.value)


def test_order_two_adds_the_middles_of_the_edges():
    """Corners stay, each edge gets one node at its middle, and changing the order twice changes nothing."""
    linear = box((0.06, 0.04, 0.04), (3, 2, 2))
    mesh = replace(linear, element_order=2)
    np.testing.assert_array_equal(mesh.vertices[: len(linear.vertices)], linear.vertices)
    np.testing.assert_array_equal(mesh.elements[:, :4], linear.tetrahedra)
    middles = mesh.vertices[mesh.tetrahedra[:, TET_EDGES]].mean(axis=2)
    np.testing.assert_allclose(mesh.vertices[mesh.elements[:, 4:]], middles, atol=1e-15)
    assert len(np.unique(mesh.elements)) == len(mesh.vertices) == len(np.unique(mesh.vertices.round(9), axis=0))
    np.testing.assert_array_equal(replace(mesh, element_order=2).elements, mesh.elements)
    np.testing.assert_array_equal(replace(mesh, element_order=1).vertices, linear.vertices)


def test_surface_of_order_two_is_the_same_body():
    """The quartered faces enclose the same volume with the same area, and use corners and middles."""
    linear = box((0.06, 0.04, 0.04), (3, 2, 2))
    mesh = replace(linear, element_order=2)
    assert len(mesh.surface_triangles) == 4 * len(linear.surface_triangles)
    a, b, c = np.moveaxis(mesh.vertices[mesh.surface_triangles], 1, 0)
    normals = np.cross(b - a, c - a) / 2.0
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(0.0128)
    assert np.einsum("ij,ij->", normals, a) / 3.0 == pytest.approx(mesh.volume)
    on_boundary = (np.abs(np.abs(mesh.vertices) - mesh.extents / 2) < 1e-9).any(axis=1)
    np.testing.assert_array_equal(mesh.surface_nodes, np.flatnonzero(on_boundary))


@pytest.mark.parametrize("order", [1, 2])
def test_nodes_carry_the_volume(order):
    """Nodal volumes are positive, sum to the volume and have its centroid; a mean of equal values is that value."""
    mesh = replace(box((0.06, 0.04, 0.04), (3, 2, 2)), element_order=order)
    assert (mesh.node_volumes > 0.0).all()
    assert mesh.node_volumes.sum() == pytest.approx(mesh.volume)
    np.testing.assert_allclose(mesh.node_volumes @ mesh.vertices, 0.0, atol=1e-18)
    np.testing.assert_allclose(mesh.nodal_mean(np.full(len(mesh.tetrahedra), 7.0)), 7.0)


def test_unknown_order_is_refused():
    """Elements of other orders do not exist; the message says which do."""
    with pytest.raises(InvalidMeshError, match="element_order = 3 .* give 1 or 2"):
        replace(box((1, 1, 1), (1, 1, 1)), element_order=3)
