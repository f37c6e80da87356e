"""The commands ``defgrasp mesh``, ``sample``, ``objects`` and ``grippers`` as a user calls them."""

import json
import sys

import pytest
import trimesh

from defgrasp_ros import cli
from defgrasp_ros.grasp_files import read_grasps, write_grasps
from defgrasp_ros.mesh.mesh_files import read_mesh
from defgrasp_ros.mesh.shapes import kidney_surface

PNG = b"\x89PNG"


@pytest.fixture
def defgrasp(monkeypatch, capsys):
    """Run the command in this process; return exit status, standard output and standard error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["defgrasp", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
            sys.exit(0)
        output = capsys.readouterr()
        return end.value.code or 0, output.out, output.err

    return run


@pytest.fixture(scope="module")
def kidney(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "kidney.ply"
    trimesh.Trimesh(*kidney_surface(), process=False).export(path)
    return path


def test_mesh_reports_and_writes(defgrasp, kidney, tmp_path):
    """The report names size and quality; the tetrahedra that were written are those reported."""
    status, out, _ = defgrasp("mesh", kidney, "--edge-length", "0.01", "--material", "kidney", "-o", tmp_path / "k.tet")
    assert status == 0
    for words in ("5120 triangles, watertight", "mm, volume 89.79 cm^3", "dihedral angles"):
        assert words in out
    status, out, _ = defgrasp("mesh", tmp_path / "k.tet", "--report")
    document = json.loads(out)
    assert status == 0 and document["nodes"] == len(read_mesh(tmp_path / "k.tet").vertices)
    assert document["triangles"] is None and document["warnings"] == []


def test_sample_writes_grasps_and_picture(defgrasp, kidney, tmp_path):
    """The files hold as many grasps as asked for, in both formats, the same for the same seed."""
    for name in ("a.h5", "b.json"):
        status, _, err = defgrasp("sample", kidney, "-n", 5, "--seed", 3, "-o", tmp_path / name)
        assert status == 0, err
    first, second = (read_grasps(tmp_path / name) for name in ("a.h5", "b.json"))
    assert len(first) == len(second) == 5
    for one, other in zip(first, second, strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-12)
    status, _, _ = defgrasp("sample", "sphere", "-n", 3, "--picture", tmp_path / "p.png", "--gripper", "round_pads")
    assert status == 0 and (tmp_path / "p.png").read_bytes().startswith(PNG)
    status, out, _ = defgrasp("sample", "sphere", "-n", 2, "--sampler", "polar")
    assert status == 0 and "approach" in out


def test_given_grasps_are_checked(defgrasp, kidney, tmp_path):
    """Of a file's grasps those at which the gripper does not fit are left out, with the reason."""
    defgrasp("sample", kidney, "-n", 3, "-o", tmp_path / "good.json")
    document = json.loads((tmp_path / "good.json").read_text())
    far = {"id": "far away", "position": [1.0, 0.0, 0.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
    document["grasps"].append(far)
    (tmp_path / "mixed.json").write_text(json.dumps(document))
    status, _, err = defgrasp("sample", kidney, "--check", tmp_path / "mixed.json", "-o", tmp_path / "kept.json")
    assert status == 0 and "left out far away: nothing is between the pads" in err
    assert [grasp.id for grasp in read_grasps(tmp_path / "kept.json")] == ["0", "1", "2"]
    write_grasps(
        tmp_path / "none.json", [grasp for grasp in read_grasps(tmp_path / "mixed.json") if grasp.id[0] == "f"]
    )
    status, _, err = defgrasp("sample", kidney, "--check", tmp_path / "none.json")
    assert status == 1 and "fits at none" in err


def test_objects_and_materials_are_listed(defgrasp):
    """Names, sizes and sources."""
    _, out, _ = defgrasp("objects")
    assert "strawberry" in out and "semi_axes" in out
    _, out, _ = defgrasp("objects", "--materials")
    assert "gelatin" in out and "Ashby" in out


def test_grippers_are_listed_and_written(defgrasp, tmp_path):
    """The list has them all; one is written as URDF."""
    _, out, _ = defgrasp("grippers")
    assert "robotiq_2f_85" in out
    status, _, _ = defgrasp("grippers", "franka_hand", "-o", tmp_path / "hand.urdf")
    assert status == 0 and "<robot" in (tmp_path / "hand.urdf").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("mesh", "unicorn"), "object 'unicorn' is not in the library"),
        (("mesh", "unicorn.stl"), "'unicorn.stl' does not exist"),
        (("mesh", "sphere", "--wall-thickness", "0.001"), "--wall-thickness belongs to mesh files"),
        (("sample", "sphere", "--sampler", "lucky"), "sampler 'lucky' is unknown"),
        (("sample", "sphere", "-n", "0"), "count = 0"),
        (("sample", "sphere", "-o", "x.txt"), "extension '.txt' is unknown"),
        (("grippers", "claw"), "gripper 'claw' is unknown"),
    ],
)
def test_mistakes_end_with_one_line(defgrasp, arguments, words, tmp_path, monkeypatch):
    """Exit status 1, what is wrong on standard error, no traceback."""
    monkeypatch.chdir(tmp_path)
    status, out, err = defgrasp(*arguments)
    assert status == 1 and words in err and "Traceback" not in err and out == ""
