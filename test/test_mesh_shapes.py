"""Shapes made by formulae, and the measure of element quality."""

import numpy as np
import pytest
import trimesh

from defgrasp_ros.mesh.object_mesh import mesh_from_surface
from defgrasp_ros.mesh.quality import dihedral_angles
from defgrasp_ros.mesh.shapes import box, kidney_surface
from defgrasp_ros.mesh.tet_mesh import TetMesh


def test_box_is_exact_and_conforming():
    """The block has its volume, is centred, and has no faces inside: cells share whole faces."""
    cells = (3, 4, 5)
    mesh = box([0.06, 0.04, 0.03], cells)
    assert len(mesh.vertices) == 4 * 5 * 6
    assert len(mesh.tetrahedra) == 5 * 3 * 4 * 5
    assert mesh.volume == pytest.approx(0.06 * 0.04 * 0.03, rel=1e-12)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.03, 0.02, 0.015])
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [-0.03, -0.02, -0.015])
    assert len(mesh.surface_triangles) == 4 * (3 * 4 + 4 * 5 + 3 * 5)


def test_dihedral_angles_of_known_tetrahedra():
    """Regular: arccos(1/3) six times; a cube's corner: three right angles and three of arccos(1/sqrt 3)."""
    regular = TetMesh([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], [[0, 1, 2, 3]])
    np.testing.assert_allclose(dihedral_angles(regular), np.arccos(1.0 / 3.0))
    corner = TetMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]])
    expected = [np.arccos(3.0**-0.5)] * 3 + [np.pi / 2.0] * 3
    np.testing.assert_allclose(np.sort(dihedral_angles(corner)[0]), expected)


def test_kidney_surface_is_a_solid_that_stands():
    """Closed, of the stated size, hollow on one side, with the centre of mass above its flat base."""
    vertices, triangles = kidney_surface()
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    assert surface.is_watertight and surface.volume > 0.0
    np.testing.assert_allclose(surface.extents, [0.098, 0.048, 0.039], atol=5e-4)
    assert not surface.is_convex
    base = vertices[vertices[:, 2] == 0.0, :2]
    assert vertices[:, 2].min() == 0.0 and len(base) > 50
    assert (base.min(axis=0) < surface.center_mass[:2] - 0.005).all()
    assert (base.max(axis=0) > surface.center_mass[:2] + 0.005).all()


def test_kidney_can_be_meshed():
    """About 1 000 nodes of well-shaped elements."""
    mesh = mesh_from_surface(*kidney_surface())
    assert 800 <= len(mesh.vertices) <= 1200
    assert np.degrees(dihedral_angles(mesh).min()) > 8.0
