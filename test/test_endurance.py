"""The evaluator in the long run, and under fire from several sides; real processes."""

from __future__ import annotations

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from ros_processes import isolated_ros, running_evaluator

pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from test_evaluation_action import BLOCK, CENTRE, MATERIAL, SHORT, START_TIMEOUT, TIMEOUT  # noqa: E402

from defgrasp_ros.client import GraspEvaluatorClient  # noqa: E402
from defgrasp_ros.errors import ResultCode  # noqa: E402
from defgrasp_ros.recording import read_log  # noqa: E402

MANY_GOALS = Path(__file__).resolve().parents[1] / "benchmarks" / "many_goals.py"
GOALS = 40


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_memory_stays_flat_over_many_goals() -> None:
    """After the first goals the evaluator's memory grows by less than 2 % over as many again.

    The benchmark does the same with 200 goals and more.
    """
    command = [sys.executable, MANY_GOALS, str(GOALS)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=580)
    assert run.returncode == 0, run.stdout + run.stderr
    figures = json.loads(run.stdout.splitlines()[-1])
    assert figures["goals"] == GOALS
    assert figures["growth_percent"] < 2.0


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_two_clients_at_once_get_their_own_answers(tmp_path: Path) -> None:
    """Each of several goals of two clients is answered with the grasps that it asked for, and has its own log."""
    count = 4

    def ask(client: GraspEvaluatorClient, name: str) -> list[Path]:
        logs = []
        for index in range(count):
            finished: list[str] = []
            answer = client.evaluate_grasps(
                BLOCK,
                MATERIAL,
                [CENTRE],
                object_name=f"{name}{index}",
                options=SHORT,
                on_evaluation=lambda each, finished=finished: finished.append(each.grasp_id),
                timeout=TIMEOUT,
            )
            assert answer.code == ResultCode.OK and finished == ["centre"]
            logs.append(answer.log_path)
        return logs

    with (
        isolated_ros(),
        running_evaluator(tmp_path),
        GraspEvaluatorClient(node_name="first") as first,
        GraspEvaluatorClient(node_name="second") as second,
        ThreadPoolExecutor() as threads,
    ):
        for client in (first, second):
            client.wait_until_ready(START_TIMEOUT)
        logs = threads.map(ask, (first, second), ("first", "second"))
        names = [[read_log(log).on("request")[0].object.name for log in each] for each in logs]
    assert names == [[f"{name}{index}" for index in range(count)] for name in ("first", "second")]
