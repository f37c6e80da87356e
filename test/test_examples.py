"""The examples, run as the README says."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

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
