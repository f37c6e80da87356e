"""Tetrahedra from surfaces."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError, TetrahedralizationError
from defgrasp_ros.mesh import cache
from defgrasp_ros.mesh import tetrahedralize as module
from defgrasp_ros.mesh.quality import dihedral_angles
from defgrasp_ros.mesh.tetrahedralize import tetrahedralize


@pytest.fixture(autouse=True)
def empty_cache(tmp_path_factory, monkeypatch):
    """No test finds what another one has made."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("empty")))


@pytest.fixture(scope="module")
def block():
    return trimesh.creation.box([0.06, 0.04, 0.03])


def test_block_keeps_its_shape(block):
    """Volume is exact, faces stay flat and corners stay corners, with well-shaped elements."""
    mesh = tetrahedralize(block.vertices, block.faces, target_edge_length=0.01)
    assert mesh.volume == pytest.approx(block.volume, rel=1e-9)
    distance = np.abs(np.abs(mesh.vertices[mesh.surface_nodes]) - block.extents / 2.0).min(axis=1)
    assert distance.max() < 1e-4
    np.testing.assert_allclose(mesh.extents, block.extents, atol=1e-4)
    assert np.degrees(dihedral_angles(mesh).min()) > 10.0


def test_equal_input_gives_equal_tetrahedra(block):
    """Two runs agree to the bit."""
    first, second = (tetrahedralize(block.vertices, block.faces, target_edge_length=0.012) for _ in range(2))
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.tetrahedra, second.tetrahedra)


def test_smaller_edge_length_gives_more_elements(block):
    """A third of the edge length gives at least eight times the elements (27 times, were there no boundary)."""
    coarse, fine = (len(tetrahedralize(block.vertices, block.faces, h).tetrahedra) for h in (0.015, 0.005))
    assert fine > 8 * coarse


@pytest.mark.parametrize("order", [1, 2])
def test_scan_becomes_a_mesh_that_can_be_simulated(shared_directory, order):
    """A raw scan of 15 728 triangles gives about 1 000 nodes, with its volume and no nearly flat element."""
    scan = trimesh.load_mesh(shared_directory / "meshes" / "ycb_011_banana.stl")
    mesh = replace(tetrahedralize(scan.vertices, scan.faces, element_order=order), element_order=order)
    assert 800 < len(mesh.vertices) < 1200
    assert mesh.volume == pytest.approx(scan.volume, rel=1e-6)
    assert np.degrees(dihedral_angles(mesh).min()) > 8.0
    # The decimated surface lies within the envelope around the scan, and so does the mesh.
    _, distance, _ = trimesh.proximity.closest_point(scan, mesh.vertices[mesh.surface_nodes][::10])
    assert distance.max() < 1.5e-3


def test_too_fine_an_edge_length_is_refused(block):
    """The limit is checked before any work is done, and the text gives what is possible."""
    with pytest.raises(MeshTooLargeError, match=r"target_edge_length = 0\.0001 m.*at least 0\.00"):
        tetrahedralize(block.vertices, block.faces, target_edge_length=1e-4)


@pytest.mark.parametrize("edge_length", [0.0, -0.01, float("nan"), 0.5])
def test_edge_length_without_meaning_is_refused(block, edge_length):
    """It must be positive, and no larger than the object."""
    with pytest.raises(InvalidMeshError, match="target_edge_length"):
        tetrahedralize(block.vertices, block.faces, target_edge_length=edge_length)


def test_missing_volume_is_an_error(block):
    """Where the tetrahedra fill less than the solid, it is not passed over in silence."""
    with pytest.raises(TetrahedralizationError, match="overlaps itself"):
        tetrahedralize(block.vertices, block.faces, target_edge_length=0.015, volume=2.0 * block.volume)


def test_mesher_that_takes_too_long_is_stopped(block, monkeypatch):
    """The time limit ends the mesher's process with a reason."""
    monkeypatch.setattr(module, "TIME_LIMIT", 0.01)
    with pytest.raises(TetrahedralizationError, match=r"did not finish in 0\.01 s"):
        tetrahedralize(block.vertices, block.faces)


def test_mesher_that_crashes_is_reported(block, monkeypatch, tmp_path):
    """A crash of the native mesher ends its own process only; the text names the signal."""
    worker = tmp_path / "worker.py"
    worker.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    monkeypatch.setattr(module, "WORKER", worker)
    with pytest.raises(TetrahedralizationError, match="SIGSEGV"):
        tetrahedralize(block.vertices, block.faces)


def test_mesher_without_memory_is_reported(block, monkeypatch):
    """Running into the memory limit is an error with a reason, not a dead caller."""
    monkeypatch.setattr(module, "MEMORY_LIMIT", 2**20)
    with pytest.raises(TetrahedralizationError, match="the mesher failed"):
        tetrahedralize(block.vertices, block.faces)


def test_mesher_leaves_no_trace(block, capfd, monkeypatch, tmp_path):
    """Standard output belongs to the caller, and so does the working directory."""
    monkeypatch.chdir(tmp_path)
    tetrahedralize(block.vertices, block.faces, target_edge_length=0.015)
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err == ""
    assert list(tmp_path.iterdir()) == []


def test_meshes_are_cached(block, monkeypatch):
    """The second time the mesher is not run, another surface or edge length is no hit, and a broken file is no harm."""
    first = tetrahedralize(block.vertices, block.faces, target_edge_length=0.015)
    monkeypatch.setattr(module, "WORKER", module.WORKER.with_name("no_worker.py"))
    again = tetrahedralize(block.vertices, block.faces, target_edge_length=0.015)
    assert np.array_equal(first.vertices, again.vertices) and np.array_equal(first.tetrahedra, again.tetrahedra)
    for vertices, edge_length in ((block.vertices, 0.014), (block.vertices * 1.001, 0.015)):
        with pytest.raises(TetrahedralizationError):
            tetrahedralize(vertices, block.faces, target_edge_length=edge_length)
    (kept,) = cache.cache_directory().glob("*.npz")
    kept.write_bytes(kept.read_bytes()[:100])
    with pytest.raises(TetrahedralizationError):
        tetrahedralize(block.vertices, block.faces, target_edge_length=0.015)
