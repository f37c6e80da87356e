"""Bad meshes: each ends in a usable mesh or in an error that names the problem, and the caller lives."""

import base64
import json
import resource
import struct
import zlib

import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import InvalidMeshError
from defgrasp_ros.mesh import mesh_files, tetrahedralize
from defgrasp_ros.mesh.mesh_files import read_mesh_bytes
from defgrasp_ros.mesh.object_mesh import mesh_from_surface, mesh_from_tetrahedra
from defgrasp_ros.mesh.quality import dihedral_angles

SIZE = 0.04
EDGE = 0.012


def block(extents=(SIZE, SIZE, SIZE)):
    return trimesh.creation.box(extents)


def stl(mesh):
    return mesh.export(file_type="stl")


def moved(mesh, *offset):
    mesh = mesh.copy()
    mesh.apply_translation(offset)
    return mesh


def joined(*meshes):
    return trimesh.util.concatenate(meshes)


def with_vertex(value):
    mesh = block()
    vertices = np.array(mesh.vertices)
    vertices[3, 1] = value
    with np.errstate(invalid="ignore"):  # the file holds normals, too
        return stl(trimesh.Trimesh(vertices, mesh.faces, process=False))


def tet_text(vertices, tetrahedra):
    lines = ["v {} {} {}".format(*vertex) for vertex in vertices]
    return "\n".join(lines + ["t {} {} {} {}".format(*tet) for tet in tetrahedra]).encode()


def gltf(**changes):
    """A glTF document of one triangle, changed."""
    data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32).tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [
            {"byteLength": len(data), "uri": "data:application/gltf-buffer;base64," + base64.b64encode(data).decode()}
        ],
        **changes,
    }
    return json.dumps(document).encode()


def vtu_bomb(size):
    """A compressed file of a few kilobytes that says it holds ``size`` bytes of zeros, and does."""
    block_size = 2**24
    packed = zlib.compress(b"\0" * block_size, 9)
    count = size // block_size
    header = struct.pack(f"<{3 + count}I", count, block_size, 0, *[len(packed)] * count)
    data = base64.b64encode(header).decode() + base64.b64encode(packed * count).decode()
    return f"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" compressor="vtkZLibDataCompressor">
<UnstructuredGrid><Piece NumberOfPoints="{size // 24}" NumberOfCells="1"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="binary">{data}</DataArray>
</Points></Piece></UnstructuredGrid></VTKFile>""".encode()


ENTITIES = (
    b"""<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "xxxxxxxxxx">"""
    + b"".join(f'<!ENTITY {chr(98 + i)} "{10 * f"&{chr(97 + i)};"}">'.encode() for i in range(9))
    + b"]><VTKFile>&j;</VTKFile>"
)

GLB_HEADER = struct.pack("<4sII", b"glTF", 2, 2**31 - 1)
REGULAR = [[0, 0, 0], [SIZE, SIZE, 0], [SIZE, 0, SIZE], [0, SIZE, SIZE]]

UNREADABLE = {
    "empty file": ("stl", b""),
    "only white space": ("obj", b"   \n\n"),
    "binary garbage as stl": ("stl", np.random.default_rng(0).bytes(5000)),
    "binary garbage as glb": ("glb", np.random.default_rng(1).bytes(5000)),
    "binary garbage as vtu": ("vtu", np.random.default_rng(2).bytes(5000)),
    "binary garbage as msh": ("msh", np.random.default_rng(3).bytes(5000)),
    "truncated stl": ("stl", stl(block())[:400]),
    "truncated glb": ("glb", block().export(file_type="glb")[:300]),
    "truncated off": ("off", b"OFF\n8 12 0\n0 0 0\n"),
    "truncated mesh": ("mesh", b"MeshVersionFormatted 1\nDimension 3\nVertices\n4\n0 0 0 1\n"),
    "stl that claims a billion triangles": ("stl", b"\0" * 80 + struct.pack("<I", 10**9) + b"\0" * 50),
    "ply that claims a billion vertices": (
        "ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1000000000\nproperty list uchar int vertex_indices\nend_header\n",
    ),
    "mesh that claims a billion vertices": ("mesh", b"Dimension 3 Vertices 1000000000 0 0 0 0"),
    "glb that claims two gigabytes": ("glb", GLB_HEADER + struct.pack("<II", 2**31 - 100, 0x4E4F534A)),
    "gltf with a bomb for accessor": (
        "gltf",
        gltf(accessors=[{"componentType": 5126, "count": 2 * 10**9, "type": "VEC3"}]),
    ),
    "gltf with a buffer outside": ("gltf", gltf(buffers=[{"byteLength": 36, "uri": "../../../../etc/passwd"}])),
    "vtu zip bomb": ("vtu", vtu_bomb(2**33)),
    "vtu with exponential entities": ("vtu", ENTITIES),
    "wrong extension: png": ("stl", b"\x89PNG\r\n\x1a\n" + b"\0" * 200),
    "wrong extension: obj named ply": ("ply", block().export(file_type="obj").encode()),
    "unknown extension": ("exe", b"MZ"),
    "path as extension": ("../../etc/passwd", b"x"),
    "vertices without triangles": ("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
    "nan in a text": ("tet", b"v nan 0 0\nv 0.01 0 0\nv 0 0.01 0\nv 0 0 0.01\nt 0 1 2 3\n"),
    "index beyond 64 bits": ("tet", b"v 0 0 0\nt 0 1 2 99999999999999999999999\n"),
    "index out of range": ("tet", tet_text(REGULAR, [[0, 1, 2, 9]])),
    "negative index": ("tet", tet_text(REGULAR, [[0, 1, 2, -1]])),
}


def half_sphere():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=SIZE)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] > 0.0], process=False)


NO_SOLID = {
    "nan vertex": ("stl", with_vertex(np.nan), "not finite"),
    "infinite vertex": ("stl", with_vertex(np.inf), "not finite"),
    "one triangle": ("gltf", gltf(), "size|watertight|between"),
    "open box": ("stl", stl(trimesh.Trimesh(block().vertices, block().faces[:-2])), "not watertight"),
    "half a sphere": ("stl", stl(half_sphere()), "not watertight"),
    "two sided sheet": (
        "obj",
        b"v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\nf 1 3 2\n",
        "no volume",
    ),
    "two components": ("stl", stl(joined(block(), moved(block(), 0.1, 0, 0))), "2 bodies"),
    "kilometre sized": ("stl", stl(block((4e3, 4e3, 4e3))), "unit looks wrong"),
    "nanometre sized": ("stl", stl(block((4e-9, 4e-9, 4e-9))), "unit looks wrong|without area"),
    "all vertices in one place": ("obj", b"v 0.01 0 0\n" * 3 + b"f 1 2 3\n", "measures 0 x 0 x 0|without area"),
    "flat tetrahedron": (
        "tet",
        tet_text([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]], [[0, 1, 2, 3]]),
        "volume",
    ),
    "repeated corner": ("tet", tet_text(REGULAR, [[0, 1, 2, 2]]), "volume"),
    "tetrahedra far apart": (
        "tet",
        tet_text([*REGULAR, *(np.array(REGULAR) + 0.1).tolist()], [[0, 1, 2, 3], [4, 5, 6, 7]]),
        "2 bodies",
    ),
}


def flipped():
    mesh = block()
    faces = np.array(mesh.faces)
    faces[[1, 4, 8]] = faces[[1, 4, 8], ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def inverted():
    mesh = block()
    mesh.invert()
    return mesh


def with_small_hole():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=SIZE / 2.0)
    near_the_top = ball.triangles_center[:, 2] > 0.9985 * SIZE / 2.0
    return trimesh.Trimesh(ball.vertices, ball.faces[~near_the_top], process=False)


def with_degenerate_triangles():
    mesh = block()
    faces = np.concatenate([mesh.faces, [[0, 0, 1], [2, 2, 2]]])
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def with_crumb():
    return joined(block(), moved(block((0.003,) * 3), 0.05, 0, 0))


def overlapping():
    return joined(block(), moved(block(), SIZE / 2.0, SIZE / 4.0, 0.0))


def touching_at_an_edge():
    return joined(block(), moved(block((SIZE, SIZE, SIZE)), SIZE, SIZE, 0.0))


def self_crossing():
    """A tube whose end is pushed through its own side."""
    ring = trimesh.creation.torus(0.025, 0.009, major_sections=48, minor_sections=16)
    vertices = np.array(ring.vertices)
    turn = np.arctan2(vertices[:, 1], vertices[:, 0])
    vertices[:, 0] *= 1.0 - 0.55 * np.exp(-((turn / 0.4) ** 2))
    return trimesh.Trimesh(vertices, ring.faces, process=False)


MENDED = {
    "inside out": (inverted, SIZE**3),
    "triangles wound the wrong way": (flipped, SIZE**3),
    "every triangle twice": (lambda: joined(block(), block()), SIZE**3),
    "triangles without area": (with_degenerate_triangles, SIZE**3),
    "small hole": (with_small_hole, np.pi * SIZE**3 / 6.0),
    "crumb beside": (with_crumb, SIZE**3),
    "two boxes that overlap": (overlapping, SIZE**3 * (2.0 - 3.0 / 8.0)),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_unreadable_files_are_invalid_meshes(name):
    """What cannot be read is refused with a text, whatever it claims to be."""
    format, data = UNREADABLE[name]
    with pytest.raises(InvalidMeshError) as caught:
        read_mesh_bytes(data, format)
    assert len(str(caught.value)) > 15


@pytest.mark.parametrize("name", NO_SOLID)
def test_what_is_no_solid_is_refused(name):
    """What can be read but not simulated is refused, and the text names the fault."""
    format, data, words = NO_SOLID[name]
    with pytest.raises(InvalidMeshError, match=words):
        read_mesh_bytes(data, format, target_edge_length=EDGE) if format != "tet" else read_mesh_bytes(data, format)


@pytest.mark.parametrize("name", MENDED)
def test_faults_with_one_cure_are_mended(name):
    """Where there is one way to mend it, the mesh has the volume of the solid that was meant."""
    make, volume = MENDED[name]
    mesh = read_mesh_bytes(stl(make()), "stl", target_edge_length=EDGE)
    assert mesh.volume == pytest.approx(volume, rel=0.02)
    assert mesh.volumes.min() > 0.0
    assert np.degrees(dihedral_angles(mesh).min()) > 2.0


@pytest.mark.parametrize("make", [self_crossing, touching_at_an_edge])
def test_surfaces_that_meet_themselves_end_well(make):
    """A body that crosses itself, or touches itself along an edge, gives a sound mesh or an error."""
    surface = make()
    try:
        mesh = mesh_from_surface(surface.vertices, surface.faces, target_edge_length=0.008)
    except InvalidMeshError as error:
        assert len(str(error)) > 15
    else:
        assert mesh.volumes.min() > 0.0


def test_edge_of_three_sheets_is_refused():
    """A fin on a box belongs to no inside."""
    mesh = block()
    vertices = np.concatenate([mesh.vertices, [[0.06, 0.06, 0.0]]])
    with pytest.raises(InvalidMeshError, match="watertight"):
        mesh_from_surface(vertices, np.concatenate([mesh.faces, [[0, 1, 8]]]))


def test_moebius_band_has_no_two_sides():
    """A wall on a one-sided surface is refused."""
    turns, across = np.meshgrid(np.linspace(0, 2 * np.pi, 25)[:-1], [-0.008, 0.008], indexing="ij")
    radius = 0.03 + across * np.cos(turns / 2)
    vertices = np.stack([radius * np.cos(turns), radius * np.sin(turns), across * np.sin(turns / 2)], axis=-1)
    here, after = np.arange(24), np.roll(np.arange(24), -1)
    low, high = 2 * here, 2 * here + 1
    next_low, next_high = 2 * after, 2 * after + 1
    next_low[-1], next_high[-1] = next_high[-1], next_low[-1]
    faces = np.concatenate([np.column_stack([low, next_low, high]), np.column_stack([high, next_low, next_high])])
    with pytest.raises(InvalidMeshError, match="two sides"):
        mesh_from_surface(vertices.reshape(-1, 3), faces, wall_thickness=0.001)


@pytest.mark.parametrize(
    "vertices, cells, words",
    [
        (np.zeros((4, 2)), [[0, 1, 2]], "shape"),
        (np.zeros((0, 3)), [[0, 1, 2]], "index"),
        (np.eye(3), np.zeros((0, 3), dtype=int), "triangle"),
        (np.eye(3), [[0, 1, 5]], "index 5"),
        (np.eye(3), [[0, 1, -2]], "index -2"),
    ],
)
def test_arrays_that_fit_nothing_are_refused(vertices, cells, words):
    """The error says what is wrong with which array."""
    with pytest.raises(InvalidMeshError, match=words):
        mesh_from_surface(vertices, np.array(cells))


def test_two_million_triangles_are_refused_and_many_are_meshed():
    """Above the limit a surface is refused before any work; below it, it is decimated."""
    count = 2_000_001
    with pytest.raises(InvalidMeshError, match="2000001 triangles"):
        mesh_from_surface(np.random.default_rng(0).random((100, 3)) * 0.1, np.zeros((count, 3), dtype=int))
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.03)
    mesh = mesh_from_surface(ball.vertices, ball.faces, target_edge_length=0.012)
    assert len(ball.faces) > 80_000 and mesh.volume == pytest.approx(ball.volume, rel=1e-3)


def test_too_many_tetrahedra_are_refused():
    """The limit is checked before anything is done with them."""
    with pytest.raises(InvalidMeshError, match="30000 tetrahedra"):
        mesh_from_tetrahedra(np.eye(4)[:, :3], np.zeros((30_000, 4), dtype=int))


def test_a_file_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    """A file of any size is refused by its size alone."""
    monkeypatch.setattr(mesh_files, "MAX_FILE_SIZE", 1000)
    path = tmp_path / "large.stl"
    path.write_bytes(b"\0" * 1001)
    with pytest.raises(InvalidMeshError, match="1000 bytes"):
        mesh_files.read_mesh(path)


def test_a_parser_that_hangs_is_stopped(tmp_path, monkeypatch):
    """The time limit of the parser's process ends in an error of the caller."""
    worker = tmp_path / "worker.py"
    worker.write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr(mesh_files, "PARSE_WORKER", worker)
    monkeypatch.setattr(mesh_files, "PARSE_TIME_LIMIT", 0.3)
    with pytest.raises(InvalidMeshError, match="not finished in 0.3 s"):
        read_mesh_bytes(b"x", "glb")


def test_the_limits_are_those_of_the_worker_alone():
    """Reading with limits leaves this process without them."""
    read = resource.getrlimit(resource.RLIMIT_AS)
    with pytest.raises(InvalidMeshError):
        read_mesh_bytes(b"nothing", "vtu")
    assert resource.getrlimit(resource.RLIMIT_AS) == read
    assert tetrahedralize.MEMORY_LIMIT > 0
