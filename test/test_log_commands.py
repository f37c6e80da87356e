"""The commands for logs: what they say of a log, what a replay publishes, and what a repeated run compares."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from ros_processes import isolated_ros, running_evaluator
from typer.testing import CliRunner

from defgrasp_ros.errors import NotFoundError
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box

pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from defgrasp_ros.cli import app  # noqa: E402
from defgrasp_ros.client import GraspEvaluatorClient, RegisteredObject  # noqa: E402
from defgrasp_ros.recording import LogReader, RunLog, Topic, read_log  # noqa: E402

BLOCK = box((0.03, 0.04, 0.03), (2, 3, 2))
MATERIAL = Material(youngs_modulus=1e5)
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
SHORT = EvaluationOptions(pickup_hold_time=0.1, platform_speed=1.0, squeeze_time=0.1, time_step=0.02)
TIMEOUT = 100.0


@pytest.fixture(scope="module")
def run_log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The bag folder of a run on an object that was registered, and of which the request knows only the name."""
    directory = tmp_path_factory.mktemp("logs")
    grasps = [
        Grasp(np.zeros(3), FROM_ABOVE, id="centre"),
        Grasp(np.array([0.0, 0.2, 0.0]), FROM_ABOVE, id="beside [m]"),
    ]
    with isolated_ros():
        with running_evaluator(directory), GraspEvaluatorClient() as client:
            client.wait_until_ready(TIMEOUT)
            client.register_object(BLOCK, MATERIAL, "block")
            answer = client.evaluate_grasps(
                RegisteredObject("block"), MATERIAL, grasps, object_name="block", options=SHORT, timeout=TIMEOUT
            )
        assert answer.log_path is not None
        yield answer.log_path.parent


def defgrasp(*arguments: object) -> str:
    """Return what the command prints; it must succeed."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, (result.output, result.exception)
    return result.stdout


def test_info_tells_how_the_run_was_made_and_ended(run_log: Path) -> None:
    """The document counts the messages, and has topics with their quality of service, run facts and outcomes."""
    document = json.loads(defgrasp("info", run_log, "--json"))
    run = read_log(run_log)
    assert document["complete"]
    assert document["message_count"] == len(run.messages) > 10
    topics = {topic["name"].rpartition("/")[2]: topic for topic in document["topics"]}
    assert topics["evaluations"]["type"] == "defgrasp_interfaces/msg/GraspEvaluation"
    assert topics["evaluations"]["message_count"] == 2
    assert topics["evaluations"]["qos"]["durability"] == "transient_local"
    assert topics["joint_states"]["qos"]["durability"] == "volatile"
    assert document["run"]["device"] == "cpu"
    assert {"version.warp-lang", "git_revision", "seed", "parameters", "gripper"} <= set(document["run"])
    assert document["attachments"].keys() == {"object.mesh", "gripper.urdf"}
    assert document["object_name"] == "block"
    outcomes = [(each["grasp_id"], each["result"]["name"]) for each in document["outcomes"]]
    assert outcomes == [("centre", "OK"), ("beside [m]", "NO_CONTACT")]
    text = defgrasp("info", run_log)
    assert "beside [m]" in text and "transient local" in text


def test_info_reads_a_log_without_end(run_log: Path, tmp_path: Path) -> None:
    """Of a log that was cut off, everything before the cut is told, and that it ends early."""
    (whole,) = run_log.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    document = json.loads(defgrasp("info", cut, "--json"))
    assert not document["complete"]
    assert document["attachments"].keys() == {"object.mesh", "gripper.urdf"}
    assert "ends early" in defgrasp("info", cut)


def test_repeated_run_gives_the_same_numbers(run_log: Path) -> None:
    """Mesh, gripper, parameters and request of the log are all that the run was made of: nothing differs."""
    document = json.loads(defgrasp("rerun", run_log, "--json"))
    assert document["same_outcomes"]
    assert [each["recorded_outcome"] for each in document["grasps"]] == ["OK", "NO_CONTACT"]
    differences = document["grasps"][0]["differences"]
    assert {"max_von_mises_stress", "squeeze_distance"} <= differences.keys()
    assert all(each["relative"] == 0.0 for grasp in document["grasps"] for each in grasp["differences"].values())


def test_another_outcome_is_exit_status_1(run_log: Path, tmp_path: Path) -> None:
    """A log that tells of another outcome and of other numbers than the simulation is told apart."""
    reader = LogReader(run_log)
    changed = [(message.topic.name, message) for message in reader]
    evaluations = next(name for name, _ in changed if name.endswith("/evaluations"))
    topics = [Topic(name, object_of(name, reader), depth=1) for name in reader.topics]
    with RunLog(tmp_path, "run", topics, reader.provenance, reader.attachments.values()) as log:
        for name, message in changed:
            content = from_cdr(message.data, object_of(name, reader))
            if name == evaluations and content.grasp_id == "centre":
                content.result.code = 134
                content.metrics.strain_energy *= 2.0
            log.write(name, content, message.publish_time)
    result = CliRunner().invoke(app, ["rerun", str(log.path), "--json"])
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    assert not document["same_outcomes"]
    assert document["grasps"][0]["recorded_outcome"] == "DROPPED"
    assert document["grasps"][0]["differences"]["strain_energy"]["relative"] == pytest.approx(0.5)


def object_of(topic: str, reader: LogReader) -> type:
    from defgrasp_ros.ros.player import replayed_topic

    return replayed_topic(reader.topics[topic]).message_class


def from_cdr(data: bytes, message_class: type) -> object:
    from rclpy.serialization import deserialize_message

    return deserialize_message(data, message_class)


LISTENER = """
import sys, time
from pathlib import Path
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from defgrasp_ros.recording import LogReader, RunLog, Topic
from defgrasp_ros.ros.player import replayed_topic
log, directory = Path(sys.argv[1]), Path(sys.argv[2])
reader = LogReader(log)
expected = sum(1 for _ in reader)
topics = [replayed_topic(topic) for topic in reader.topics.values()]
rclpy.init()
node = rclpy.create_node("listener")
received = 0
def subscribe(topic):
    durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
    def take(data):
        global received
        copy.write(topic.name, data, 0)
        received += 1
    node.create_subscription(topic.message_class, topic.name, take, QoSProfile(depth=10000, durability=durability))
with RunLog(directory, "copy", topics, {}) as copy:
    for topic in topics:
        subscribe(topic)
    print("listening", flush=True)
    end = time.monotonic() + 60.0
    while received < expected and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
"""


def test_replayed_log_equals_the_recorded_one(run_log: Path, tmp_path: Path) -> None:
    """Another process that listens to all topics receives each message of the log, byte for byte and in its order."""
    command = [sys.executable, "-c", LISTENER, run_log, tmp_path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None and listener.stdout.readline().strip() == "listening"
        replay = [sys.executable, "-m", "defgrasp_ros.cli", "replay", run_log, "--rate", "10"]
        subprocess.run(replay, check=True, timeout=TIMEOUT)
        listener.wait(TIMEOUT)
    recorded, received = LogReader(run_log), LogReader(tmp_path / "copy")
    for reader in (recorded, received):
        list(reader)
    for topic in recorded.topics:
        sent = [message.data for message in LogReader(run_log) if message.topic.name == topic]
        arrived = [message.data for message in LogReader(tmp_path / "copy") if message.topic.name == topic]
        assert sent == arrived, topic
    assert {name: topic.qos for name, topic in received.topics.items()} == {
        name: topic.qos for name, topic in recorded.topics.items()
    }


@pytest.fixture
def small_log(tmp_path: Path) -> Path:
    """A log of one second: a latched description, ten joint states, and a description that comes later."""
    topics = [Topic("/robot_description", String, depth=1, latched=True), Topic("/joints", JointState, depth=100)]
    with RunLog(tmp_path, "small", topics, {}) as log:
        log.write("/robot_description", String(data="gripper"), 0)
        for number in range(10):
            log.write("/joints", JointState(position=[float(number)]), 0)
            time.sleep(0.1)
        log.write("/robot_description", String(data="end"), 0)
    return tmp_path / "small"


COLLECTOR = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
rclpy.init()
node = rclpy.create_node("collector")
def say(text):
    print(text, flush=True)
node.create_subscription(String, "/robot_description", lambda m: say("description " + m.data), latched)
node.create_subscription(JointState, "/joints", lambda m: say(f"joints {m.position[0]:g}"), 100)
node.create_subscription(
    Clock, "/clock", lambda m: say(f"clock {(m.clock.sec * 10**9 + m.clock.nanosec) * 1e-9}"),
    QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
)
say("listening")
rclpy.spin(node)
"""


@pytest.fixture
def collector() -> Iterator[subprocess.Popen]:
    """A process that prints what it receives, on a domain that it shares with this process alone."""
    with (
        isolated_ros(),
        subprocess.Popen([sys.executable, "-c", COLLECTOR], stdout=subprocess.PIPE, text=True) as heard,
    ):
        assert heard.stdout is not None and heard.stdout.readline()
        try:
            yield heard
        finally:
            heard.kill()


def heard_until(collector: subprocess.Popen, last: str, count: int = 1) -> list[str]:
    """Return what was received until ``last`` came ``count`` times without anything else between."""
    assert collector.stdout is not None
    heard: list[str] = []
    for line in collector.stdout:
        heard.append(line.strip())
        if heard[-count:] == [last] * count:
            return heard
    raise AssertionError(f"'{last}' never came: {heard}")


def test_replay_starts_where_asked(small_log: Path, collector: subprocess.Popen) -> None:
    """From the middle on, with the latched message from before, and the clock of the log."""
    times = [message.log_time for message in LogReader(small_log)]
    middle = 1e-9 * (times[6] - times[0]) - 0.001  # the description, then joints 0 to 9
    defgrasp("replay", small_log, "--start", f"{middle:.6f}", "--rate", "0.5", "--clock")
    heard = heard_until(collector, "description end")
    texts = [text for text in heard if not text.startswith("clock")]
    assert texts == ["description gripper", *(f"joints {number}" for number in range(5, 10)), "description end"]
    clocks = [float(text.split()[1]) for text in heard if text.startswith("clock")]
    assert len(clocks) > 5
    assert clocks == sorted(clocks)
    assert 1e-9 * times[5] < clocks[0] and clocks[-1] <= 1e-9 * times[-1] + 1e-6


def test_time_of_a_replay_follows_rate_and_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """Log time passes at the rate, stands still in a pause, and begins anew where asked."""
    from defgrasp_ros.ros.playback_timer import PlaybackTimer

    wall = 1_000
    monkeypatch.setattr("time.monotonic_ns", lambda: wall)
    timer = PlaybackTimer(start=0, rate=2.0)
    wall += 100
    assert timer.position == 200
    timer.toggle_pause()
    wall += 1_000
    assert timer.paused and timer.position == 200
    timer.toggle_pause()
    wall += 10
    assert timer.position == 220
    timer.restart(5_000)
    wall += 1
    assert timer.position == 5_002


def test_replay_of_some_topics(small_log: Path, collector: subprocess.Popen) -> None:
    """What is not named is not published."""
    assert "joints" in defgrasp("info", small_log)
    defgrasp("replay", small_log, "--topics", "robot_description", "--rate", "10")
    texts = heard_until(collector, "description end")
    assert texts == ["description gripper", "description end"]


def test_replay_loops_until_it_is_interrupted(small_log: Path, collector: subprocess.Popen) -> None:
    """After the end the beginning comes again; Ctrl-C ends it."""
    command = [sys.executable, "-m", "defgrasp_ros.cli", "replay", str(small_log), "--loop", "--rate", "20"]
    with subprocess.Popen(command) as replay:
        for _ in range(3):
            heard_until(collector, "description end")
        replay.send_signal(signal.SIGINT)
        assert replay.wait(TIMEOUT) == 0


def test_space_bar_lets_a_paused_replay_go_on(small_log: Path, collector: subprocess.Popen) -> None:
    """A replay that begins paused publishes nothing but its standing clock until the space bar is pressed."""
    start = next(iter(LogReader(small_log))).log_time * 1e-9
    terminal, stdin = pty.openpty()
    command = [sys.executable, "-m", "defgrasp_ros.cli", "replay", str(small_log), "--pause", "--clock"]
    with subprocess.Popen(command, stdin=stdin) as replay:
        try:
            heard_until(collector, f"clock {start}", count=5)
            os.write(terminal, b"x ")
            heard = heard_until(collector, "description end")
            assert replay.wait(TIMEOUT) == 0
        finally:
            replay.kill()
    os.close(stdin)
    os.close(terminal)
    texts = [text for text in heard if not text.startswith("clock")]
    assert texts == ["description gripper", *(f"joints {number}" for number in range(10)), "description end"]


@pytest.mark.parametrize("command", ["info", "replay", "rerun", "export", "report"])
def test_missing_log_is_not_found(tmp_path: Path, command: str) -> None:
    """The error says which log is missing and what to give instead."""
    more = ["--csv", str(tmp_path)] if command == "export" else []
    with isolated_ros():
        result = CliRunner().invoke(app, [command, str(tmp_path / "gone"), *more])
    assert result.exit_code == 1
    assert isinstance(result.exception, NotFoundError)
    assert f"there is no log {tmp_path / 'gone'}; give the bag folder" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--rate", "0"], "--rate = 0"),
        (["--start", "99"], "outside of the log"),
        (["--topics", "nothing"], "no topic 'nothing'"),
        (["--pause"], "needs a terminal"),
    ],
)
def test_impossible_replay_is_refused(small_log: Path, arguments: list[str], text: str) -> None:
    """The error names the option and what would be possible."""
    with isolated_ros():
        result = CliRunner().invoke(app, ["replay", str(small_log), *arguments])
    assert result.exit_code == 1
    assert text in str(result.exception)
