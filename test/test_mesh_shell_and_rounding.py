"""Walls inside of surfaces, rounded edges, and measuring what a surface encloses."""

import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import InvalidMeshError, TetrahedralizationError
from defgrasp_ros.mesh.object_mesh import mesh_from_surface
from defgrasp_ros.mesh.overlap import enclosed_volume
from defgrasp_ros.mesh.rounding import with_rounded_edges
from defgrasp_ros.mesh.shell import shell_mesh


@pytest.mark.parametrize("order, layers", [(1, 2), (2, 1)])
def test_box_has_flat_walls_of_even_thickness(order, layers):
    """At edges and corners the inner surface stays a box: the volume is that of the difference of two boxes."""
    box = trimesh.creation.box([0.06, 0.05, 0.04])
    mesh = shell_mesh(box.vertices, box.faces, 0.002, element_order=order)
    inner = np.array([0.056, 0.046, 0.036])
    assert mesh.volume == pytest.approx(box.volume - inner.prod(), rel=1e-6)
    outside = (np.abs(np.abs(mesh.vertices) - box.extents / 2.0) < 1e-9).any(axis=1)
    inside = (np.abs(np.abs(mesh.vertices) - inner / 2.0) < 1e-9).any(axis=1)
    assert (outside | inside).sum() == pytest.approx(2.0 / (layers + 1) * len(mesh.vertices), abs=1)


@pytest.mark.parametrize("order, most_nodes", [(1, 1200), (2, 2000)])
def test_ball_becomes_a_shell(order, most_nodes):
    """A closed surface gives a sealed hollow body with the thickness all around; fewer triangles would dent a ball."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    mesh = mesh_from_surface(ball.vertices, ball.faces, wall_thickness=0.003, element_order=order)
    assert mesh.volume == pytest.approx(4.0 / 3.0 * np.pi * (0.03**3 - 0.027**3), rel=0.02)
    assert 800 < len(mesh.vertices) < most_nodes
    inner = np.linalg.norm(mesh.corners, axis=1).min()
    assert inner == pytest.approx(0.027, abs=2e-4)


def test_open_surface_becomes_a_cup():
    """A surface that is open at the top gives a wall that is open there."""
    box = trimesh.creation.box([0.05, 0.05, 0.06])
    top = box.triangles_center[:, 2] > 0.029
    mesh = mesh_from_surface(box.vertices, box.faces[~top], wall_thickness=0.002, target_edge_length=0.008)
    surface = trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False)
    assert surface.is_watertight and surface.euler_number == 2
    assert mesh.volume == pytest.approx(0.05 * 0.05 * 0.06 - 0.046 * 0.046 * 0.058, rel=0.01)


def test_walls_that_meet_are_refused():
    """A wall thicker than half of a plate, or than the radius of a rod, does not fit; the text says so."""
    plate = trimesh.creation.box([0.06, 0.05, 0.005])
    with pytest.raises(TetrahedralizationError, match="does not fit"):
        shell_mesh(plate.vertices, plate.faces, 0.003)
    with pytest.raises(InvalidMeshError, match="wall_thickness"):
        shell_mesh(plate.vertices, plate.faces, -0.001)


def test_rounding_takes_away_what_a_fillet_does():
    """A rounded box loses (1 - pi/4) r^2 per length of edge, within a third, keeps its faces and its extents nearly."""
    extents, radius = np.array([0.05, 0.04, 0.03]), 0.004
    rounded = with_rounded_edges(trimesh.creation.box(extents), radius)
    assert rounded.is_watertight
    expected = (1.0 - np.pi / 4.0) * radius**2 * 4.0 * extents.sum()
    assert extents.prod() - rounded.volume == pytest.approx(expected, rel=1.0 / 3.0)
    np.testing.assert_allclose(rounded.extents, extents, rtol=1e-3)
    assert rounded.face_adjacency_angles.max() < np.radians(50.0)
    middle = np.abs(rounded.vertices[:, :2]).max(axis=1) < 0.01
    top = rounded.vertices[:, 2] > 0.0
    np.testing.assert_allclose(rounded.vertices[middle & top, 2], 0.015, atol=1e-9)


def test_smooth_surfaces_are_left_alone():
    """A sphere has no sharp edge."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    assert with_rounded_edges(ball, 0.002) is ball
    with pytest.raises(InvalidMeshError, match="edge_radius"):
        with_rounded_edges(trimesh.creation.box([0.05, 0.04, 0.03]), 0.02)


@pytest.mark.parametrize("shift", [0.0, 0.01, 0.02])
def test_overlap_of_two_boxes_is_measured(shift):
    """Union and overlap of two cubes are those of the formula, within the 1 % of the method."""
    side = 0.04
    one, other = trimesh.creation.box([side] * 3), trimesh.creation.box([side] * 3)
    other.apply_translation([side - shift, 0.0, 0.0])
    both = trimesh.util.concatenate([one, other])
    measured = enclosed_volume(np.asarray(both.vertices), np.asarray(both.faces))
    overlap = shift * side**2
    assert measured.union == pytest.approx(2.0 * side**3 - overlap, rel=0.01)
    assert measured.overlap == pytest.approx(overlap, rel=0.02, abs=1e-12)
