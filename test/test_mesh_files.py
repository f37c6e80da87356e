"""Reading object meshes: every format, every fault."""

import logging
from dataclasses import replace

import meshio
import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import (
    InvalidMeshError,
    MeshNotWatertightError,
    MeshTooLargeError,
    NotFoundError,
)
from defgrasp_ros.mesh import object_mesh, surface
from defgrasp_ros.mesh.mesh_files import MESH_FORMATS, SURFACE_FORMATS, read_mesh, read_mesh_bytes
from defgrasp_ros.mesh.object_mesh import mesh_from_surface, mesh_from_tetrahedra
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.surface import closed_surface

EXTENTS = np.array([0.06, 0.04, 0.03])
VOLUME = EXTENTS.prod()


@pytest.fixture
def block():
    return trimesh.creation.box(EXTENTS)


def as_surface(mesh, format):
    if format == "gltf":
        return trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh), embed_buffers=True)["model.gltf"]
    exported = mesh.export(file_type=format)
    return exported.encode() if isinstance(exported, str) else exported


def as_msh(points, cells, tmp_path, file_format):
    path = tmp_path / "object.msh"
    meshio.Mesh(points, cells).write(path, file_format=file_format)
    return path


@pytest.mark.parametrize("format", SURFACE_FORMATS)
def test_surface_formats(block, tmp_path, format):
    """Each surface format gives the solid block, whatever the case of the extension."""
    path = tmp_path / f"block.{format.upper()}"
    path.write_bytes(as_surface(block, format))
    mesh = read_mesh(path, target_edge_length=0.015)
    assert mesh.volume == pytest.approx(VOLUME, rel=1e-5)
    np.testing.assert_allclose(mesh.extents, EXTENTS, atol=2e-3)


def test_tet_grammar():
    """Comments, blank lines, labels after the numbers, and numbers of either sign are read."""
    text = """# Tetrahedral mesh
    # 4 vertices

    v 0.0 0.0 0.0 7
    v 1e-2 0 0
    v 0 +0.01 0 # a comment
    v 0 0 .01 0
    t 0 1 2 3 1
    """
    mesh = read_mesh_bytes(text.encode(), "tet")
    assert mesh.tetrahedra.shape == (1, 4)
    assert mesh.volume == pytest.approx(0.01**3 / 6.0)


def test_reference_object(shared_directory):
    """The published sample has its published size."""
    mesh = read_mesh(shared_directory / "reference" / "objects" / "rectangle.tet")
    assert (len(mesh.vertices), len(mesh.tetrahedra)) == (364, 968)
    assert mesh.volume == pytest.approx(3.4534e-5, rel=1e-4)


@pytest.mark.parametrize("file_format, with_triangles", [("gmsh22", True), ("gmsh", False)])
def test_msh_with_tetrahedra_is_taken_as_it_is(tmp_path, file_format, with_triangles):
    """Tetrahedra of a file are kept, in both versions of the format; triangles beside them are ignored."""
    block = box(EXTENTS, (2, 2, 2))
    cells = [("triangle", block.surface_triangles)] * with_triangles + [("tetra", block.tetrahedra)]
    mesh = read_mesh(as_msh(block.vertices, cells, tmp_path, file_format))
    assert len(mesh.tetrahedra) == len(block.tetrahedra)
    assert mesh.volume == pytest.approx(VOLUME)


def test_msh_with_triangles_is_filled(block, tmp_path):
    """A Gmsh file that holds a surface is tetrahedralised."""
    path = as_msh(block.vertices, [("triangle", block.faces)], tmp_path, "gmsh22")
    assert read_mesh(path, target_edge_length=0.015).volume == pytest.approx(VOLUME, rel=1e-6)


def test_msh_without_solid_or_surface(tmp_path):
    """The error says which elements there are."""
    path = as_msh(np.eye(3), [("line", np.array([[0, 1], [1, 2]]))], tmp_path, "gmsh22")
    with pytest.raises(InvalidMeshError, match="but line"):
        read_mesh(path)


def test_scale_converts_units(block):
    """A file in millimetres is read with scale 0.001; without it the error says so."""
    block.apply_scale(1000.0)
    data = as_surface(block, "stl")
    np.testing.assert_allclose(
        read_mesh_bytes(data, "stl", scale=0.001, target_edge_length=0.015).extents, EXTENTS, atol=2e-3
    )
    with pytest.raises(InvalidMeshError, match=r"60 x 40 x 30 m.*scale=0\.001"):
        read_mesh_bytes(data, "stl")
    with pytest.raises(InvalidMeshError, match=r"between 0\.001 and 2 m"):
        read_mesh_bytes(data, "stl", scale=1e-6)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_scale_must_be_positive(scale):
    """Other factors have no meaning."""
    block = box(EXTENTS, (1, 1, 1))
    with pytest.raises(InvalidMeshError, match="scale"):
        mesh_from_tetrahedra(block.vertices, block.tetrahedra, scale=scale)


def test_surface_inside_out_is_turned(block):
    """Normals that point inwards are no fault of the object."""
    block.invert()
    assert closed_surface(block.vertices, block.faces).volume == pytest.approx(VOLUME)


def test_triangles_wound_the_wrong_way_are_turned(block):
    """Single flipped triangles are turned to agree with their neighbours."""
    faces = block.faces.copy()
    faces[[2, 7]] = faces[[2, 7], ::-1]
    assert closed_surface(block.vertices, faces).volume == pytest.approx(VOLUME)


def test_unmerged_vertices_are_joined(block):
    """Three vertices of its own for each triangle, as in STL, are no holes."""
    vertices = block.vertices[block.faces].reshape(-1, 3)
    joined = closed_surface(vertices, np.arange(len(vertices)).reshape(-1, 3))
    assert len(joined.vertices) == 8


def test_texture_seams_are_joined():
    """A vertex that a format repeats because of its texture coordinates is one vertex."""
    corners = [(x, y, z) for x in (0, 0.04) for y in (0, 0.04) for z in (0, 0.04)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "vt 0.5 0.5"]
    lines += ["f " + " ".join(f"{v + 1}/{(i + f) % 5 + 1}" for i, v in enumerate(quad)) for f, quad in enumerate(quads)]
    mesh = read_mesh_bytes("\n".join(lines).encode(), "obj", target_edge_length=0.02)
    assert mesh.volume == pytest.approx(0.04**3, rel=1e-6)


def test_holes_are_counted_and_located(block):
    """The text gives the number of boundary edges and holes, and where the largest one is."""
    block = block.subdivide()
    centres = block.triangles_center
    top = np.isclose(centres[:, 2], EXTENTS[2] / 2.0)
    one_on_bottom = np.flatnonzero(np.isclose(centres[:, 2], -EXTENTS[2] / 2.0))[0]
    keep = ~top
    keep[one_on_bottom] = False
    with pytest.raises(MeshNotWatertightError) as caught:
        mesh_from_surface(block.vertices, block.faces[keep])
    for words in ("11 boundary edges", "2 holes", "0.0721 m across", "(0, 0, 0.015)"):
        assert words in str(caught.value)


def test_flat_surface_is_no_solid():
    """A double-sided sheet is closed, but encloses nothing."""
    sheet = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    with pytest.raises(InvalidMeshError, match="no volume"):
        mesh_from_surface(sheet, [[0, 1, 2], [0, 2, 1]])


def test_separate_bodies_are_refused(block):
    """Two blocks side by side are not one object; the text gives their volumes."""
    other = trimesh.creation.box([0.02, 0.02, 0.02])
    other.apply_translation([0.1, 0.0, 0.0])
    both = trimesh.util.concatenate([block, other])
    with pytest.raises(InvalidMeshError, match=r"2 bodies.*72, 8 cm\^3"):
        mesh_from_surface(both.vertices, both.faces, target_edge_length=0.01)


def test_specks_are_left_out_with_a_warning(caplog):
    """A loose crumb of a scan does not make the object unusable, but is not passed over in silence."""
    block, crumb = box(EXTENTS, (2, 2, 2)), box([0.003] * 3, (1, 1, 1))
    vertices = np.concatenate([block.vertices, crumb.vertices + 0.05])
    tetrahedra = np.concatenate([block.tetrahedra, crumb.tetrahedra + len(block.vertices)])
    with caplog.at_level(logging.WARNING):
        mesh = mesh_from_tetrahedra(vertices, tetrahedra)
    assert mesh.volume == pytest.approx(VOLUME)
    assert "left out 1 loose speck" in caplog.text


def test_almost_flat_elements_are_reported(caplog):
    """They are accepted, as the caller chose them, with a warning."""
    with caplog.at_level(logging.WARNING):
        mesh_from_tetrahedra([[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0.005, 0.005, 1e-4]], [[0, 1, 2, 3]])
    assert "1 of 1 tetrahedra are almost flat" in caplog.text


def test_hollow_bodies_keep_their_cavity():
    """An inner surface whose normals point into the cavity is no separate body."""
    shell, cavity = trimesh.creation.box([0.06] * 3), trimesh.creation.box([0.03] * 3)
    cavity.invert()
    hollow = trimesh.util.concatenate([shell, cavity])
    mesh = mesh_from_surface(hollow.vertices, hollow.faces, target_edge_length=0.015)
    assert mesh.volume == pytest.approx(0.06**3 - 0.03**3, rel=1e-6)


def test_limits(block, monkeypatch):
    """Too many tetrahedra or triangles have their own error, before work is done."""
    mesh = box(EXTENTS, (2, 2, 2))
    monkeypatch.setattr(object_mesh, "MAX_TETRAHEDRA", 39)
    with pytest.raises(MeshTooLargeError, match="40 tetrahedra, more than 39"):
        mesh_from_tetrahedra(mesh.vertices, mesh.tetrahedra)
    monkeypatch.setattr(object_mesh, "MAX_NODES", 100)
    with pytest.raises(MeshTooLargeError, match="117 nodes at element_order = 2, more than 100"):
        mesh_from_tetrahedra(mesh.vertices, mesh.tetrahedra[:39], element_order=2)
    monkeypatch.setattr(surface, "MAX_TRIANGLES", 11)
    with pytest.raises(MeshTooLargeError, match="12 triangles, more than 11"):
        mesh_from_surface(block.vertices, block.faces)


@pytest.mark.parametrize("order", [1, 2])
def test_default_size_counts_nodes(block, order):
    """Without an edge length a surface gets about 1 000 nodes at either order, and one body of the same volume."""
    mesh = mesh_from_surface(block.vertices, block.faces, element_order=order)
    assert mesh.element_order == order
    assert 500 < len(mesh.vertices) < 1500
    assert mesh.volume == pytest.approx(np.prod(EXTENTS), rel=1e-6)


@pytest.mark.parametrize(
    "vertices, triangles, words",
    [
        (np.zeros((3, 2)), [[0, 1, 2]], ["vertices", "(3, 2)"]),
        (np.eye(3), np.zeros((0, 3), int), ["triangles", "(0, 3)"]),
        (np.eye(3), [[0, 1, 3]], ["index 3", "3 vertices"]),
        (np.eye(3), [[0, 1, -1]], ["index -1"]),
        (np.eye(3) * np.nan, [[0, 1, 2]], ["vertex 0", "not finite"]),
        (np.eye(3), [[0, 1, 1]], ["without area"]),
    ],
)
def test_faulty_arrays_are_named(vertices, triangles, words):
    """The error names the array and the value."""
    with pytest.raises(InvalidMeshError) as caught:
        mesh_from_surface(vertices, triangles)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "format, data, words",
    [
        ("tet", b"v 0 0 0\nv 0 zero 0\n", ["line 2", "v 0 zero 0"]),
        ("tet", b"v 0 0\n", ["line 1"]),
        ("tet", b"t 0 1 2 3\n", ["vertices"]),
        ("tet", b"v 0 0 0\nv 0.1 0 0\n", ["tetrahedra"]),
        ("tet", b"hello\n", ["line 1", "hello"]),
        ("tet", b"\xff\xfe\x00binary", ["line 1"]),
        ("stl", b"solid nothing", ["stl"]),
        ("stl", b"\x00" * 100, ["no triangles"]),
        ("ply", b"no ply at all", ["ply"]),
        ("off", b"OFF\n3 1", ["off"]),
        ("obj", b"v 0 0 0\n", ["obj"]),
        ("msh", b"$MeshFormat\nnonsense", ["msh"]),
        ("msh", b"nothing", ["msh"]),
        ("stl", b"", ["0 bytes"]),
        ("step", b"ISO-10303-21;", ["step", *MESH_FORMATS]),
    ],
)
def test_unreadable_data_is_an_invalid_mesh(tmp_path, format, data, words):
    """No content of a file ends in another exception; from a file, its path is named too."""
    with pytest.raises(InvalidMeshError) as caught:
        read_mesh_bytes(data, format)
    path = tmp_path / f"object.{format}"
    path.write_bytes(data)
    with pytest.raises(InvalidMeshError) as caught_from_file:
        read_mesh(path)
    for word in words:
        assert word in str(caught.value)
    assert str(caught_from_file.value) == f"{path}: {caught.value}"


def test_truncated_scan_is_an_invalid_mesh(block):
    """Half a binary file is refused."""
    data = as_surface(block.subdivide(), "stl")
    with pytest.raises(InvalidMeshError):
        read_mesh_bytes(data[: len(data) // 2], "stl")


def test_missing_file(tmp_path):
    """An absent file and a folder are told apart from a bad mesh."""
    with pytest.raises(NotFoundError, match=r"absent\.stl"):
        read_mesh(tmp_path / "absent.stl")
    with pytest.raises(NotFoundError, match="not a file"):
        read_mesh(tmp_path)


def test_file_keeps_the_class_of_the_error(block, tmp_path):
    """The path is added to the text; the class, from which the result code comes, stays."""
    open_block = trimesh.Trimesh(block.vertices, block.faces[1:], process=False)
    path = tmp_path / "open.stl"
    path.write_bytes(as_surface(open_block, "stl"))
    with pytest.raises(MeshNotWatertightError, match=r"open\.stl: .*3 boundary edges around 1 hole,"):
        read_mesh(path)


def test_point_cloud_is_no_surface():
    """A file of a surface format without triangles says so."""
    data = trimesh.PointCloud(np.eye(3)).export(file_type="ply")
    with pytest.raises(InvalidMeshError, match="no triangles"):
        read_mesh_bytes(data, "ply")


def test_tetrahedra_of_both_kinds_are_refused(tmp_path):
    """Half of the object would be missing otherwise."""
    block = replace(box(EXTENTS, (1, 1, 1)), element_order=2)
    path = tmp_path / "both.vtu"
    meshio.Mesh(block.vertices, [("tetra", block.tetrahedra[:2]), ("tetra10", block.elements[2:])]).write(path)
    with pytest.raises(InvalidMeshError, match="of four and of ten nodes"):
        read_mesh(path)


def test_middle_nodes_out_of_range_are_refused(tmp_path):
    """The error names the index, as for corners."""
    block = replace(box(EXTENTS, (1, 1, 1)), element_order=2)
    cells = block.elements.copy()
    cells[0, 9] = 10_000
    meshio.Mesh(block.vertices, [("tetra10", cells)]).write(tmp_path / "bad.vtu")
    with pytest.raises(InvalidMeshError, match="bad.vtu.*index 10000, but the mesh has"):
        read_mesh(tmp_path / "bad.vtu")
