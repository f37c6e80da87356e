"""What is reported of a mesh, and files of tetrahedra."""

import json
from dataclasses import replace

import meshio
import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import InvalidMeshError
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.mesh_files import TEXT_FORMATS, prepare_file, read_mesh, read_surface
from defgrasp_ros.mesh.mesh_writer import WRITTEN_FORMATS, write_mesh
from defgrasp_ros.mesh.object_mesh import prepare_surface, prepare_tetrahedra
from defgrasp_ros.mesh.quality import aspect_ratios
from defgrasp_ros.mesh.report import mesh_report
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh

EXTENTS = np.array([0.06, 0.04, 0.02])


def test_report_of_a_block():
    """Size, mass and inertia are those of the formulae."""
    block = box(EXTENTS, (3, 2, 1))
    prepared = prepare_tetrahedra(block.vertices + [0.0, 0.0, 0.01], block.tetrahedra)
    report = mesh_report("block", prepared, Material(density=1200.0))
    mass = 1200.0 * EXTENTS.prod()
    assert report.mass == pytest.approx(mass)
    np.testing.assert_allclose(report.center_of_mass, [0.0, 0.0, 0.01], atol=1e-12)
    x, y, z = EXTENTS**2
    np.testing.assert_allclose(report.inertia, mass / 12.0 * np.diag([y + z, x + z, x + y]), rtol=1e-9, atol=1e-15)
    assert (report.nodes, report.tetrahedra) == (24, 30)
    text = "\n".join(report.lines())
    for words in ("24 nodes", "60.0 x 40.0 x 20.0 mm", "48 cm^3", "57.6 g"):
        assert words in text
    assert json.loads(json.dumps(report.document()))["mass"] == pytest.approx(mass)


def test_aspect_ratio_of_known_elements():
    """1 for a regular tetrahedron; a corner of a cube has sqrt(2) (3 + sqrt(3)) / (2 sqrt(6))."""
    regular = TetMesh([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], [[0, 1, 2, 3]])
    assert aspect_ratios(regular)[0] == pytest.approx(1.0)
    corner = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 1, 2, 3]])
    assert aspect_ratios(corner)[0] == pytest.approx(2.0**0.5 * (3.0 + 3.0**0.5) / (2.0 * 6.0**0.5))


def test_report_says_what_was_mended():
    """Holes, turned triangles and specks are listed, and a surface that was open is not called watertight."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    faces = np.delete(np.asarray(ball.faces), 7, axis=0)
    faces[3] = faces[3, ::-1]
    report = mesh_report("ball", prepare_surface(ball.vertices, faces, target_edge_length=0.008), Material())
    assert report.watertight is False and report.triangles == len(faces)
    assert any("small hole" in mend for mend in report.mends)
    assert any("wound the wrong way" in mend for mend in report.mends)


def test_large_objects_raise_a_doubt():
    """An object that fits into no gripper is reported as such."""
    block = box(10.0 * EXTENTS, (2, 2, 2))
    report = mesh_report("crate", prepare_tetrahedra(block.vertices, block.tetrahedra), Material())
    assert any("are the units right" in warning for warning in report.warnings)


@pytest.mark.parametrize("format", WRITTEN_FORMATS)
def test_written_tetrahedra_are_read_back(format, tmp_path):
    """Nodes and elements survive."""
    block = box(EXTENTS, (2, 2, 1))
    path = tmp_path / f"block.{format}"
    write_mesh(path, block)
    read = read_mesh(path)
    np.testing.assert_allclose(read.vertices, block.vertices, atol=1e-9)
    assert np.array_equal(read.tetrahedra, block.tetrahedra)


@pytest.mark.parametrize("format", WRITTEN_FORMATS)
def test_element_order_of_written_tetrahedra(format, tmp_path):
    """Formats that know elements of ten nodes keep the order; the others hold corners alone."""
    block = replace(box(EXTENTS, (2, 2, 1)), element_order=2)
    path = tmp_path / f"block.{format}"
    write_mesh(path, block)
    read = read_mesh(path)
    assert read.element_order == (1 if format in TEXT_FORMATS else 2)
    for order, mesh in ((2, read_mesh(path, element_order=2)), (1, read_mesh(path, element_order=1))):
        assert mesh.element_order == order
        assert np.array_equal(mesh.tetrahedra, block.tetrahedra)
    np.testing.assert_allclose(read_mesh(path, element_order=2).vertices, block.vertices, atol=1e-9)


def test_curved_sides_are_reported(tmp_path):
    """A middle node off its edge is put there, and the warning says how far it was."""
    block = replace(box(EXTENTS, (1, 1, 1)), element_order=2)
    vertices = block.vertices.copy()
    vertices[-1, 2] += 0.05 * block.extents.max()
    content = meshio.Mesh(vertices, [("tetra10", block.elements)])
    content.write(tmp_path / "curved.vtu")
    prepared = prepare_file(tmp_path / "curved.vtu")
    assert any("curved, by up to 5 %" in warning for warning in prepared.warnings)
    np.testing.assert_allclose(prepared.mesh.vertices, block.vertices, atol=1e-12)


def test_unknown_format_is_not_written(tmp_path):
    """The error names those that are."""
    with pytest.raises(InvalidMeshError, match="'stl' is not written.*tet"):
        write_mesh(tmp_path / "a.stl", box(EXTENTS, (1, 1, 1)))


def test_surface_of_tetrahedra_and_of_surfaces(tmp_path):
    """Both are closed and have the volume, and the surface of triangles is not filled for it."""
    block = box(EXTENTS, (2, 2, 1))
    write_mesh(tmp_path / "block.vtu", block)
    trimesh.creation.box(1e3 * EXTENTS).export(tmp_path / "block.ply")
    for name, scale in (("block.vtu", 1.0), ("block.ply", 0.001)):
        surface = read_surface(tmp_path / name, scale=scale)
        assert surface.is_watertight and surface.volume == pytest.approx(EXTENTS.prod())


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_reference_files_are_read_and_meshed(shared_directory):
    """Tetrahedra of the original load as they are; scans become 800 to 1500 nodes with their volume."""
    for path in sorted((shared_directory / "reference" / "objects").glob("*.tet")):
        report = mesh_report(path.stem, prepare_file(path), Material())
        assert report.nodes > 300 and report.min_dihedral_angle > 0.0
    for path in sorted((shared_directory / "meshes").glob("*.stl")):
        scan = trimesh.load_mesh(path)
        report = mesh_report(path.stem, prepare_file(path), Material())
        assert 800 <= report.nodes <= 1500 and report.watertight
        assert report.volume == pytest.approx(scan.volume, rel=0.01)
        assert report.min_dihedral_angle > np.radians(5.0)
