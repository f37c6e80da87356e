"""Reading and writing candidate grasps."""

import json

import h5py
import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import EmptyGraspListError, InvalidGraspError, NotFoundError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.grasp_files import grasp_from_defgraspsim, pose_of_defgraspsim, read_grasps, write_grasps
from defgrasp_ros.mesh.mesh_files import read_mesh

HALF = 0.5**0.5
IDENTITY = [0.0, 0.0, 0.0, 1.0]


def write_poses(path, poses, name="poses"):
    with h5py.File(path, "w") as file:
        file[name] = poses
    return path


def test_pose_of_defgraspsim_worked_out_by_hand():
    """A hand turned by 90 deg about x approaches along -y, with the original's closing axis x along our +-y."""
    grasp = grasp_from_defgraspsim(np.array([1.0, 2.0, 3.0, HALF, HALF, 0.0, 0.0]))
    np.testing.assert_allclose(grasp.position, [1.0, 2.0 - 0.1034, 3.0], atol=1e-12)
    pad_width, closing, approach = grasp.rotation.T
    np.testing.assert_allclose(approach, [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(closing, [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pad_width, [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("name, off_centre", [("rectangle", 1e-6), ("banana", 2e-3)])
def test_reference_grasps_enclose_their_object(shared_directory, name, off_centre):
    """The point between the pads is midway between where the closing axis enters and leaves the object."""
    objects = shared_directory / "reference" / "objects"
    mesh = read_mesh(objects / f"{name}.tet")
    surface = trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False)
    grasps = read_grasps(objects / f"{name}_grasps.h5")
    assert len(grasps) >= 20
    for grasp in grasps:
        assert (grasp.position > mesh.vertices.min(axis=0)).all() and (grasp.position < mesh.vertices.max(axis=0)).all()
        closing = grasp.rotation[:, 1]
        hits, _, _ = surface.ray.intersects_location([grasp.position - 0.5 * closing], [closing])
        along = (hits - grasp.position) @ closing
        assert along.min() < 0.0 < along.max()
        assert abs(along.min() + along.max()) / 2.0 < off_centre


def test_hdf5_rows_are_named_by_their_index(tmp_path):
    """Each row of `poses` becomes one grasp, in order."""
    poses = np.array([[0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0] for z in (0.1, 0.2)])
    grasps = read_grasps(write_poses(tmp_path / "grasps.h5", poses))
    assert [grasp.id for grasp in grasps] == ["0", "1"]
    np.testing.assert_allclose([grasp.position[2] for grasp in grasps], [0.2034, 0.3034])


def test_json_round_trip(tmp_path):
    """What is written is read back: ids, forces and positions exactly, orientations to the last bit."""
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(20, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    written = [
        Grasp(rng.normal(size=3), quaternion, id=f"grasp {i}", target_force=None if i % 2 else rng.uniform(0.1, 9.0))
        for i, quaternion in enumerate(quaternions)
    ]
    write_grasps(tmp_path / "grasps.json", written)
    read = read_grasps(tmp_path / "grasps.json")
    assert [(g.id, g.target_force, g.position.tolist()) for g in read] == [
        (g.id, g.target_force, g.position.tolist()) for g in written
    ]
    np.testing.assert_allclose([g.orientation for g in read], [g.orientation for g in written], rtol=0.0, atol=2e-16)


def test_json_may_be_a_bare_list_without_ids(tmp_path):
    """Id and target force have defaults."""
    path = tmp_path / "grasps.json"
    path.write_text(json.dumps([{"position": [0, 0, 1], "orientation": IDENTITY, "target_force": None}]))
    (grasp,) = read_grasps(path)
    assert grasp.id == "0" and grasp.target_force is None
    assert grasp.position.tolist() == [0.0, 0.0, 1.0]


def test_defgraspsim_round_trip(tmp_path):
    """Poses written in the original's layout are read back, and a file of the original is reproduced."""
    rng = np.random.default_rng(1)
    written = [Grasp(rng.normal(size=3), q / np.linalg.norm(q)) for q in rng.normal(size=(20, 4))]
    write_grasps(tmp_path / "grasps.h5", written)
    read = read_grasps(tmp_path / "grasps.h5")
    np.testing.assert_allclose([g.position for g in read], [g.position for g in written], atol=1e-14)
    np.testing.assert_allclose([g.rotation for g in read], [g.rotation for g in written], atol=1e-14)
    pose = np.array([1.0, 2.0, 3.0, HALF, HALF, 0.0, 0.0])
    np.testing.assert_allclose(pose_of_defgraspsim(grasp_from_defgraspsim(pose)), pose, atol=1e-14)


def test_unknown_extension_is_not_written(tmp_path):
    """The error names the extensions that are known."""
    with pytest.raises(InvalidGraspError, match=r"\.txt.*\.json.*\.h5"):
        write_grasps(tmp_path / "grasps.txt", [])


VALID = {"position": [0.0, 0.0, 0.0], "orientation": IDENTITY}


@pytest.mark.parametrize(
    "text, words",
    [
        ('{"grasps": [\n{"position": [0, 0 0]}]}', ["line 2"]),
        ('{"poses": []}', ["grasps", "poses"]),
        ('{"grasps": 3}', ["grasps", "int", "list"]),
        ("[[0, 0, 0]]", ["grasp 0", "list"]),
        (json.dumps([VALID, {**VALID, "quaternion": IDENTITY}]), ["grasp 1", "quaternion", "orientation"]),
        (json.dumps([VALID, {"position": [0, 0, 0]}]), ["grasp 1", "orientation", "missing"]),
        (json.dumps([{**VALID, "id": 7}]), ["grasp 0", "id", "7"]),
        (json.dumps([{**VALID, "position": [0, 0]}]), ["grasp 0", "position"]),
        (json.dumps([{**VALID, "position": "0 0 0"}]), ["grasp 0", "position", "0 0 0"]),
        (json.dumps([{**VALID, "position": [0, 0, float("nan")]}]), ["grasp 0", "position", "nan"]),
        (json.dumps([{**VALID, "orientation": [0, 0, 0, 0]}]), ["grasp 0", "orientation", "zero"]),
        (json.dumps([{**VALID, "orientation": [0, 0, 1, 1]}]), ["grasp 0", "orientation", "norm"]),
        (json.dumps([{**VALID, "target_force": -1}]), ["grasp 0", "target_force", "-1"]),
        (json.dumps([{**VALID, "target_force": "strong"}]), ["grasp 0", "target_force", "strong"]),
    ],
)
def test_faults_in_json_are_named(tmp_path, text, words):
    """The error names the file, the row, the field and the value."""
    path = tmp_path / "grasps.json"
    path.write_text(text)
    with pytest.raises(InvalidGraspError) as caught:
        read_grasps(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "poses, name, words",
    [
        (np.zeros((2, 7)), "grasps", ["poses", "grasps"]),
        (np.zeros((2, 6)), "poses", ["(2, 6)", "(grasp, 7)"]),
        (np.zeros(7), "poses", ["(7,)"]),
        (np.array([[0, 0, 0, 1.0, 0, 0, 0], [0.0] * 7]), "poses", ["row 1", "quaternion", "norm 0"]),
        (np.array([[np.nan, 0, 0, 1, 0, 0, 0]]), "poses", ["row 0", "nan"]),
        (np.array([[0, 0, 0, 1, 1, 0, 0]], dtype=float), "poses", ["row 0", "norm 1.414"]),
    ],
)
def test_faults_in_hdf5_are_named(tmp_path, poses, name, words):
    """The error names the file, the row and what is wrong."""
    path = write_poses(tmp_path / "grasps.h5", poses, name)
    with pytest.raises(InvalidGraspError) as caught:
        read_grasps(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_file_that_is_not_hdf5_is_refused(tmp_path):
    """A broken file is an invalid grasp file, not a crash."""
    path = tmp_path / "grasps.h5"
    path.write_bytes(b"no hdf5")
    with pytest.raises(InvalidGraspError, match="cannot be read"):
        read_grasps(path)


def test_missing_unknown_and_empty_files(tmp_path):
    """Each of these has its own error."""
    with pytest.raises(NotFoundError, match="absent.json"):
        read_grasps(tmp_path / "absent.json")
    with pytest.raises(NotFoundError, match="not a file"):
        read_grasps(tmp_path)
    (tmp_path / "grasps.csv").write_text("0 0 0")
    with pytest.raises(InvalidGraspError, match=r"\.csv.*\.json"):
        read_grasps(tmp_path / "grasps.csv")
    (tmp_path / "none.json").write_text("[]")
    with pytest.raises(EmptyGraspListError, match="none.json"):
        read_grasps(tmp_path / "none.json")
    with pytest.raises(EmptyGraspListError):
        read_grasps(write_poses(tmp_path / "none.h5", np.zeros((0, 7))))
