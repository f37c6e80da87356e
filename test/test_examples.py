"""The examples, run as the README says."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from ros_processes import isolated_ros, running_evaluator

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_demo(tmp_path):
    """The demonstration finds a grasp that holds, one that misses, one too weak; it leaves a log and a picture."""
    pytest.importorskip("rclpy")
    pytest.importorskip("defgrasp_interfaces")
    run = subprocess.run(
        [sys.executable, EXAMPLES / "demo.py"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ,
        timeout=850,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    for outcome in ("OK", "DROPPED", "NO_CONTACT"):
        assert re.search(rf"\b{outcome}\b", run.stdout)
    assert "Take '" in run.stdout
    assert (tmp_path / "demo_output" / "grasps.png").read_bytes().startswith(b"\x89PNG")
    assert list((tmp_path / "demo_output" / "logs").glob("*/*.mcap"))


@pytest.fixture(scope="module")
def evaluator(tmp_path_factory):
    """An evaluator for the examples that ask one."""
    pytest.importorskip("rclpy")
    pytest.importorskip("defgrasp_interfaces")
    quick = {"experiment.pickup_hold_time": 0.1, "experiment.platform_speed": 1.0, "experiment.time_step": 0.02}
    with isolated_ros(), running_evaluator(tmp_path_factory.mktemp("logs"), **quick):
        yield


@pytest.fixture
def block(tmp_path):
    """A mesh file of a small block."""
    path = tmp_path / "block.stl"
    trimesh.creation.box((0.03, 0.04, 0.03)).export(path)
    return path


def run_example(name: str, *arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, EXAMPLES / name, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=100)


def test_rank_grasps(evaluator, block):
    """The grasps of the front are printed with both measures, the least stress first."""
    run = run_example("rank_grasps.py", "--mesh", block, "--count", 4)
    assert run.returncode == 0, run.stdout + run.stderr
    found = re.findall(r"peak stress (\S+) kPa, deformation (\S+) mm", run.stdout)
    assert found
    stress, deformation = np.array(found, dtype=float).T
    assert (np.diff(stress) >= 0.0).all() and (np.diff(deformation) <= 0.0).all()


def test_watch_and_cancel(evaluator):
    """With little patience the goal is canceled, and every grasp is accounted for."""
    run = run_example("watch_and_cancel.py", "--count", 3, "--patience", 0.5)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "canceling" in run.stdout
    assert re.search(r"CANCELED: 3 grasps", run.stdout)
