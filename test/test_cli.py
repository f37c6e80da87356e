"""The ``defgrasp`` command as a user calls it."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from defgrasp_ros import cli
from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.option import options_of

FROM_ABOVE = [1.0, 0.0, 0.0, 0.0]


def defgrasp(*arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "defgrasp_ros.cli", *map(str, arguments)], capture_output=True, text=True, timeout=110
    )


def write_tet(path: Path, mesh) -> Path:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += ["t {} {} {} {}".format(*tet) for tet in mesh.tetrahedra]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> Path:
    return write_tet(tmp_path_factory.mktemp("mesh") / "block.tet", box((0.03, 0.03, 0.03), (3, 3, 3)))


@pytest.fixture(scope="module")
def grasps(tmp_path_factory) -> Path:
    entries = [
        {"id": "beside", "position": [0.06, 0.0, 0.0], "orientation": FROM_ABOVE},
        {"id": "centre", "position": [0.0, 0.0, 0.0], "orientation": FROM_ABOVE},
        {"id": "weak", "position": [0.0, 0.0, 0.0], "orientation": FROM_ABOVE, "target_force": 0.3},
    ]
    path = tmp_path_factory.mktemp("grasps") / "grasps.json"
    path.write_text(json.dumps({"grasps": entries}))
    return path


def test_json_is_all_that_is_printed(block, grasps):
    """Standard output holds one JSON document with the names of the messages, and null for what was not measured."""
    given = ["--youngs-modulus", "1e5", "--pickup-hold-time", "0.2"]
    run = defgrasp("evaluate", block, "--grasps", grasps, *given, "--json")
    assert run.returncode == 0, run.stderr
    document = json.loads(run.stdout)
    assert document["material"]["youngs_modulus"] == 1e5
    assert document["object"]["mass"] == pytest.approx(0.027)
    missed, held, weak = document["evaluations"]
    assert missed["result"]["name"] == "NO_CONTACT" and missed["result"]["code"] == ResultCode.NO_CONTACT
    assert missed["features"]["edge_distance"] is None and missed["contacts"] == []
    assert held["result"]["name"] == "OK" and held["metrics"]["pickup_success"] is True
    assert held["applied_force"] == pytest.approx(held["target_force"], rel=1e-3)
    # Where the tip fillet touches, normal forces carry a little of the weight, too.
    for force, tolerance in (("force", 1e-3), ("tangential_force", 1e-2)):
        upward = sum(finger[force][2] for finger in held["contacts"])
        assert upward == pytest.approx(0.027 * 9.81, rel=tolerance)
    assert held["solver"]["converged"] is True and held["solver"]["residual"] < 1e-6
    assert weak["target_force"] == 0.3 and weak["metrics"]["pickup_success"] is False


def test_table_names_units_and_reasons(block, grasps):
    """Without --json a table appears, and under it why each other grasp failed; rows keep their index."""
    run = defgrasp("evaluate", block, "--grasps", grasps, "--grasp-indices", "1,0", "--pickup-hold-time", "0.1")
    assert run.returncode == 0, run.stderr
    assert "1 OK, 1 NO_CONTACT" in run.stdout
    assert "beside: the object is not between the pads" in run.stdout


def test_output_folder_holds_document_and_picture(block, grasps, tmp_path):
    """--output writes the JSON document and a picture."""
    run = defgrasp(
        "evaluate",
        block,
        "--grasps",
        grasps,
        "--grasp-indices",
        "1",
        "--pickup-hold-time",
        "0.1",
        "--output",
        tmp_path / "out",
    )
    assert run.returncode == 0, run.stderr
    document = json.loads((tmp_path / "out" / "evaluations.json").read_text())
    assert document["evaluations"][0]["grasp_index"] == 1
    assert math.isfinite(document["evaluations"][0]["metrics"]["max_von_mises_stress"])
    assert (tmp_path / "out" / "evaluations.png").read_bytes().startswith(b"\x89PNG")


def test_help_lists_every_constant_with_unit_and_default(capsys, monkeypatch):
    """Each constant of the protocol is an option of its name, with unit, range and default."""
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setattr(sys, "argv", ["defgrasp", "evaluate", "--help"])
    with pytest.raises(SystemExit):
        cli.main()
    text = " ".join(capsys.readouterr().out.split())
    for name, option in options_of(EvaluationOptions).items():
        assert "--" + name.replace("_", "-") in text
        assert option.text in text
    assert "[m/s^3], in [1, 100000] [default: 1000]" in text


def test_experiments_are_in_document_and_table(block, grasps, tmp_path, monkeypatch, capsys):
    """Each experiment has its entry in the document and its metric in the table; lower bounds and reasons are told."""
    preset = tmp_path / "short.yaml"
    preset.write_text("pickup_hold_time: 0.1\nmax_linear_acceleration: 3.0\nmax_angular_acceleration: 50.0\n")
    command = ["defgrasp", "evaluate", str(block), "--grasps", str(grasps), "--grasp-indices", "0,1"]
    command += ["--preset", str(preset), "--max-angular-acceleration", "10", "--squeeze-sample-count", "2"]
    command += ["--experiments", "linear_acceleration,angular_acceleration,squeeze", "--output", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    document = json.loads((tmp_path / "evaluations.json").read_text())
    experiments = ["pickup", "linear_acceleration", "angular_acceleration", "squeeze"]
    assert document["options"]["experiments"] == experiments
    assert document["options"]["max_angular_acceleration"] == 10.0
    missed, held = document["evaluations"]
    assert [missed[name] for name in experiments[1:]] == [None] * 3
    assert held["reorientation"] is None and held["metrics"]["deformation_controllability"] is None
    for name, limit in (("linear_acceleration", 3.0), ("angular_acceleration", 10.0)):
        assert held[name]["at_loss"] == [limit] * 16 and all(held[name]["is_lower_bound"])
        assert held[name]["at_slip"] == [None] * 16
    assert held["metrics"]["linear_instability"] == 3.0
    assert held["squeeze"]["force"] == [7.5, 15.0]
    for force, fingers in zip(held["squeeze"]["force"], held["squeeze"]["contacts"], strict=True):
        assert sum(finger["normal_force"] for finger in fingers) == pytest.approx(force, rel=1e-3)
    table = capsys.readouterr().out
    assert ">=3 " in table and ">=10 " in table and "turned" not in table
    assert "beside: the object is not between the pads" in table


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--youngs-modulus", "-3"], "INVALID_MATERIAL: material.youngs_modulus = -3 Pa"),
        (["--density", "nan"], "INVALID_MATERIAL: material.density = nan"),
        (["--pickup-hold-time", "-1"], "INVALID_OPTIONS: options.pickup_hold_time = -1 s"),
        (["--linear-jerk", "2e5"], "INVALID_OPTIONS: options.linear_jerk = 200000 m/s^3 is outside [1, 100000] m/s^3"),
        (["--experiments", "shake"], "INVALID_OPTIONS: options.experiments: 'shake' is unknown; known are pickup,"),
        (["--preset", "papper"], "NOT_FOUND: preset 'papper' is unknown; known are defgraspsim_code, paper"),
        (["--grasp-indices", "9"], "row 9 does not exist; the file has rows 0 to 2"),
        (["--grasp-indices", "a"], "is not a list of row numbers"),
        (["--gripper", "claw"], "NOT_FOUND: gripper 'claw' is unknown; known: franka_hand, robotiq_2f_85, round_pads"),
        (["--device", "cuda:77"], "NOT_FOUND: device = 'cuda:77' is not available"),
        (["--time-limit", "0"], "INVALID_OPTIONS: time_limit = 0 s is outside (0, inf) s"),
    ],
)
def test_bad_input_ends_with_one_line(block, grasps, arguments, expected, monkeypatch, capsys):
    """A mistake gives exit status 1, its code and text on standard error, no traceback and no output."""
    command = ["defgrasp", "evaluate", str(block), "--grasps", str(grasps), "--json", *arguments]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 1
    output = capsys.readouterr()
    assert expected in output.err
    assert "Traceback" not in output.err and output.out == ""


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["rectangle", "ellipsoid05"])
def test_reference_objects(shared_directory, name):
    """Grasps of the original's objects run to an end; those that hold carry the weight and reach their force."""
    objects = shared_directory / "reference" / "objects"
    run = defgrasp(
        "evaluate",
        objects / f"{name}.tet",
        "--grasps",
        objects / f"{name}_grasps.h5",
        "--grasp-indices",
        "0,3,20",
        "--json",
    )
    assert run.returncode == 0, run.stderr
    document = json.loads(run.stdout)
    weight = document["object"]["mass"] * 9.81
    assert all(evaluation["solver"]["converged"] for evaluation in document["evaluations"])
    held = [evaluation for evaluation in document["evaluations"] if evaluation["result"]["name"] == "OK"]
    assert held
    for evaluation in held:
        assert evaluation["applied_force"] == pytest.approx(evaluation["target_force"], rel=1e-3)
        assert sum(finger["force"][2] for finger in evaluation["contacts"]) == pytest.approx(weight, rel=1e-3)
