"""The log of a run: what other programs read of it, and what is left of it when its writer dies."""

from __future__ import annotations

import array
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from defgrasp_ros.errors import NotFoundError, RecordingError

pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")
pytest.importorskip("sensor_msgs.msg")

from builtin_interfaces.msg import Time  # noqa: E402
from defgrasp_interfaces.msg import (  # noqa: E402
    AccelerationResult,
    ContactState,
    EvaluationRequest,
    EvaluatorStatus,
    FingerContact,
    Grasp,
    GraspEvaluation,
    ObjectField,
    ReorientationResult,
    ReorientationState,
    SqueezeResult,
)
from mcap.writer import MCAP0_MAGIC  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from shape_msgs.msg import MeshTriangle  # noqa: E402

from defgrasp_ros.gripper import load_gripper  # noqa: E402
from defgrasp_ros.gripper_urdf import gripper_urdf  # noqa: E402
from defgrasp_ros.mesh.mesh_files import read_mesh_bytes  # noqa: E402
from defgrasp_ros.mesh.shapes import box  # noqa: E402
from defgrasp_ros.recording import LogReader, RunLog, Topic, read_log, run_attachments, run_log  # noqa: E402
from defgrasp_ros.recording.bag_writer import FLUSH_INTERVAL, BagWriter  # noqa: E402

TOPICS = (
    Topic("/evaluator/request", EvaluationRequest, depth=1, latched=True),
    Topic("/evaluator/status", EvaluatorStatus, depth=1, latched=True),
    Topic("/evaluator/joint_states", JointState, depth=10),
    Topic("/evaluator/contacts", ContactState, depth=10),
    Topic("/evaluator/evaluations", GraspEvaluation, depth=50, latched=True),
)


def example_messages() -> list[tuple[str, object]]:
    """A few messages of every topic with strings, arrays and nested messages of awkward lengths."""
    request = EvaluationRequest(gripper="franka_hand", grasps=[Grasp(id="left"), Grasp(id="päd", target_force=2.5)])
    request.object.data = array.array("B", range(7))
    request.object.surface.triangles = [MeshTriangle(vertex_indices=np.array([0, 1, 2], dtype=np.uint32))]
    request.object.tetrahedra.vertices = array.array("d", [0.1, -1e300, float("inf")])
    request.object.tetrahedra.tetrahedra = array.array("I", [0, 1, 2, 4294967295])
    messages: list[tuple[str, object]] = [("/evaluator/request", request)]
    for index in range(5):
        joints = JointState(name=["left_finger_joint", "right"], position=[0.1 * index, 2.0], effort=[1.0])
        joints.header.stamp = Time(sec=index, nanosec=7)
        finger = FingerContact(name="left_finger", count=index, positions=array.array("d", np.arange(3.0 * index)))
        messages += [
            ("/evaluator/joint_states", joints),
            ("/evaluator/contacts", ContactState(grasp_id="a" * index, fingers=[finger] * (index % 3))),
            ("/evaluator/status", EvaluatorStatus(state=2, run_id="run", progress=index / 5)),
        ]
    return [*messages, ("/evaluator/evaluations", example_evaluation())]


def example_evaluation() -> GraspEvaluation:
    """A result with some of the experiments, which are sequences of at most one message."""
    field = ObjectField(stage="reorientation", positions=array.array("f", range(6)))
    turned = ReorientationResult(reasons=["", "slipped"], states=[ReorientationState(axis=3, turn=1, field=field)] * 2)
    accelerated = AccelerationResult(is_lower_bound=[True, False, True], at_loss=array.array("d", [1.5, 2.5, 3.5]))
    squeezed = SqueezeResult(contacts=[FingerContact(name="left_finger")] * 2, reason="at 3 N: no solution")
    return GraspEvaluation(
        grasp_id="päd", reorientation=[turned], linear_acceleration=[accelerated], squeeze=[squeezed]
    )


def wait_until(condition: Callable[[], object]) -> None:
    """Wait for what another thread does."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.01)


def write_example(directory: Path) -> tuple[Path, list[tuple[str, object]]]:
    messages = example_messages()
    with RunLog(directory, "run", TOPICS, {"device": "cpu"}) as log:
        for number, (topic, message) in enumerate(messages):
            log.write(topic, message, publish_time=1_000 * number)
    return log.path, messages


def equal(read: object, written: object) -> bool:
    """Whether a decoded message holds what the ROS message holds, field by field."""
    if hasattr(written, "get_fields_and_field_types"):
        return all(equal(getattr(read, name), getattr(written, name)) for name in written.get_fields_and_field_types())
    if hasattr(written, "__len__") and not isinstance(written, str):
        return len(read) == len(written) and all(map(equal, read, written))
    return read == written


def test_own_reader_returns_what_was_written(tmp_path: Path) -> None:
    """Messages, order, times and provenance come back as they were written."""
    path, messages = write_example(tmp_path)
    run = read_log(path.parent)
    assert run.complete
    assert run.provenance == {"device": "cpu"}
    assert [entry.topic for entry in run.messages] == [topic for topic, _ in messages]
    assert [entry.publish_time for entry in run.messages] == [1_000 * number for number in range(len(messages))]
    assert all(equal(entry.message, message) for entry, (_, message) in zip(run.messages, messages, strict=True))
    assert len(run.on("contacts")) == 5


def test_mcap_ros2_reader_agrees(tmp_path: Path) -> None:
    """The reader of mcap-ros2-support finds profile, statistics and every message."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path, messages = write_example(tmp_path)
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        statistics = reader.get_summary().statistics
        assert statistics.message_count == len(messages)
        assert statistics.channel_count == len(TOPICS)
        decoded = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    assert all(
        topic == wanted and equal(read, written)
        for (topic, read), (wanted, written) in zip(decoded, messages, strict=True)
    )


@pytest.mark.parametrize("opened_as", ["bag folder", "bare file"])
def test_rosbags_agrees(tmp_path: Path, opened_as: str) -> None:
    """rosbags, which refuses inexact CDR, reads every message and the quality of service of each topic."""
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import QosDurability, QosReliability

    path, messages = write_example(tmp_path)
    with AnyReader([path.parent if opened_as == "bag folder" else path]) as reader:
        profiles = {connection.topic: connection.ext.offered_qos_profiles[0] for connection in reader.connections}
        read = [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        ]
    assert set(profiles) == {topic.name for topic in TOPICS}
    for topic in TOPICS:
        assert profiles[topic.name].reliability == QosReliability.RELIABLE
        assert profiles[topic.name].depth == topic.depth
        wanted = QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE
        assert profiles[topic.name].durability == wanted
    assert all(
        topic == wanted and equal(message, written)
        for (topic, message), (wanted, written) in zip(read, messages, strict=True)
    )


def test_bag_metadata_counts_the_messages(tmp_path: Path) -> None:
    """metadata.yaml names the file, the types and how many messages each topic has."""
    path, messages = write_example(tmp_path)
    bag = yaml.safe_load((path.parent / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert bag["relative_file_paths"] == [path.name]
    assert bag["message_count"] == len(messages)
    counts = {topic["topic_metadata"]["name"]: topic["message_count"] for topic in bag["topics_with_message_count"]}
    five = {f"/evaluator/{name}": 5 for name in ("status", "joint_states", "contacts")}
    assert counts == {"/evaluator/request": 1, "/evaluator/evaluations": 1} | five


def test_file_cut_at_any_byte_is_readable_up_to_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is left of a file, its reader returns the first messages, and a longer rest never has fewer."""
    monkeypatch.setattr("defgrasp_ros.recording.bag_writer.FLUSH_INTERVAL", 0.0)  # a chunk for each message
    messages = example_messages()
    log = RunLog(tmp_path, "run", TOPICS, {"device": "cpu"})
    for topic, message in messages:
        log.write(topic, message, publish_time=0)
    log.close()
    content = log.path.read_bytes()
    cut = tmp_path / "cut.mcap"
    found = []
    for length in range(
        0, len(content) - len(MCAP0_MAGIC), 97
    ):  # after the last record nothing but the format's mark follows
        cut.write_bytes(content[:length])
        run = read_log(cut)
        assert not run.complete
        assert [entry.topic for entry in run.messages] == [topic for topic, _ in messages[: len(run.messages)]]
        found.append(len(run.messages))
    assert found == sorted(found)
    assert found[0] == 0
    assert set(found) == set(range(len(messages) + 1))


WRITER_TO_KILL = """
import sys, time
from pathlib import Path
from defgrasp_interfaces.msg import EvaluatorStatus
from defgrasp_ros.recording import RunLog, Topic
log = RunLog(Path(sys.argv[1]), "run", [Topic("/status", EvaluatorStatus, 1)], {})
for number in range(1_000_000):
    print(time.monotonic(), flush=True)
    log.write("/status", EvaluatorStatus(grasp_count=number), 0)
    time.sleep(0.005)
"""


def test_killed_writer_loses_less_than_the_flush_interval(tmp_path: Path) -> None:
    """After SIGKILL the log holds all but the messages of the last fraction of a second."""
    command = [sys.executable, "-c", WRITER_TO_KILL, tmp_path]
    write_times = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        for line in writer.stdout:
            write_times.append(float(line))
            if len(write_times) == 100:
                writer.kill()
    run = read_log(tmp_path / "run")
    assert not run.complete
    assert [message.grasp_count for message in run.on("status")] == list(range(len(run.messages)))
    assert run.messages
    lost = write_times[len(run.messages) :]
    assert not lost or lost[-1] - lost[0] < FLUSH_INTERVAL


def test_folder_that_cannot_be_made_is_a_recording_error(tmp_path: Path) -> None:
    """A path below a file names the path and the reason."""
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="file/run.*[Nn]ot a directory"):
        RunLog(tmp_path / "file", "run", TOPICS, {})


def test_full_disk_is_a_recording_error_and_leaves_a_readable_log(tmp_path: Path) -> None:
    """When no more can be written the writer says so, and what was written before can be read."""
    log = RunLog(tmp_path, "run", TOPICS, {})
    log.write("/evaluator/request", example_messages()[0][1], publish_time=0)
    wait_until(lambda: read_log(log.path).on("request"))
    _, hard_limit = soft_and_hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (log.path.stat().st_size + 1_000, hard_limit))
    try:
        noise = EvaluatorStatus(run_id=os.urandom(100_000).hex())
        with pytest.raises(RecordingError, match="cannot write the log"):
            for _ in range(100):
                log.write("/evaluator/status", noise, publish_time=0)
            log.close()
        for again in (lambda: log.write("/evaluator/status", noise, publish_time=0), log.close):
            with pytest.raises(RecordingError, match="cannot write the log"):
                again()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, soft_and_hard)
    assert len(read_log(log.path).on("request")) == 1


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    """A missing file, another format and a folder without or with several logs are errors that name the path."""
    other = tmp_path / "notes.mcap"
    other.write_text("not a log, but a longer text")
    with pytest.raises(RecordingError, match="no MCAP file"):
        read_log(other)
    with pytest.raises(NotFoundError, match="missing.mcap; give the bag folder"):
        read_log(tmp_path / "missing.mcap")
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(NotFoundError, match="holds no .mcap file"):
        read_log(folder)
    for name in ("a.mcap", "b.mcap"):
        (folder / name).touch()
    with pytest.raises(RecordingError, match="holds 2 .mcap files; name one"):
        read_log(folder)


def test_slow_disk_holds_the_caller_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the disk does not take anything, no more waits in memory than allowed; afterwards nothing is missing."""
    monkeypatch.setattr(run_log, "QUEUE_SIZE", 10_000)
    disk_works = threading.Event()
    write = BagWriter.write
    monkeypatch.setattr(BagWriter, "write", lambda *arguments: disk_works.wait() and write(*arguments))
    log = RunLog(tmp_path, "run", TOPICS, {})
    started: list[int] = []

    def simulate() -> None:
        for number in range(100):
            started.append(number)
            log.write("/evaluator/status", EvaluatorStatus(run_id="x" * 1000, grasp_count=number), publish_time=0)

    simulation = threading.Thread(target=simulate, daemon=True)
    simulation.start()
    message_size = 1_000
    wait_until(lambda: log.statistics.queued_bytes > 10_000 - 2 * message_size)
    time.sleep(0.1)
    assert log.statistics.queued_bytes <= 10_000
    assert len(started) <= 10_000 // message_size + 2, "one is being written, one waits for room"
    disk_works.set()
    simulation.join()
    log.close()
    assert log.statistics.waiting_time > 0.0
    assert log.statistics.message_count == 100
    assert log.statistics.queued_bytes == 0
    run = read_log(log.path)
    assert [message.grasp_count for message in run.on("status")] == list(range(100))


def test_caller_that_waits_is_released_when_the_disk_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer that dies, for whatever reason, is an error of the next message and holds nobody up."""
    monkeypatch.setattr(run_log, "QUEUE_SIZE", 1)

    def fail(*_: object) -> None:
        raise ZeroDivisionError("bug")

    monkeypatch.setattr(BagWriter, "write", fail)
    log = RunLog(tmp_path, "run", TOPICS, {})
    with pytest.raises(RecordingError, match="ZeroDivisionError: bug"):
        for _ in range(10):
            log.write("/evaluator/status", EvaluatorStatus(), publish_time=0)
        log.close()


@pytest.mark.parametrize("noise", [True, False], ids=["incompressible", "compressible"])
def test_log_never_exceeds_its_largest_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, noise: bool) -> None:
    """A log that reaches its size ends with an error, complete with index and metadata, and uses most of the room."""
    monkeypatch.setattr("defgrasp_ros.recording.bag_writer.FLUSH_INTERVAL", 60.0)  # chunks by size alone, at any load
    max_size = 300_000
    attachments = run_attachments(box((0.04, 0.04, 0.04), (2, 2, 2)), load_gripper())
    log = RunLog(tmp_path, "run", TOPICS, {"device": "cpu"}, attachments, max_size)
    with pytest.raises(RecordingError, match="largest size, 0.3 MB"):
        while True:  # the writer may be far behind
            log.write("/evaluator/status", EvaluatorStatus(run_id=os.urandom(500 * noise).hex()), publish_time=0)
    with pytest.raises(RecordingError, match="largest size, 0.3 MB"):
        log.close()
    size = log.path.stat().st_size
    assert 0.7 * max_size < size <= max_size
    run = read_log(log.path)
    assert run.complete
    assert len(run.messages) > 100
    bag = yaml.safe_load((log.path.parent / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert bag["message_count"] == len(run.messages)


def test_message_may_change_after_it_was_written(tmp_path: Path) -> None:
    """What is logged is the message at the time of the call, although it reaches the file later."""
    status = EvaluatorStatus()
    with RunLog(tmp_path, "run", TOPICS, {}) as log:
        for number in range(50):
            status.grasp_count = number
            log.write("/evaluator/status", status, publish_time=0)
    assert [message.grasp_count for message in read_log(log.path).on("status")] == list(range(50))


def test_mesh_and_gripper_are_inside(tmp_path: Path) -> None:
    """The attached tetrahedra read back bit for bit, and the URDF is the gripper's."""
    mesh, gripper = box((0.03, 0.041, 0.07), (2, 3, 2)), load_gripper()
    with RunLog(tmp_path, "run", TOPICS, {}, run_attachments(mesh, gripper)) as log:
        pass
    inside = read_log(log.path).attachments
    read = read_mesh_bytes(inside["object.mesh"].data, "mesh")
    np.testing.assert_array_equal(read.vertices, mesh.vertices)
    np.testing.assert_array_equal(read.tetrahedra, mesh.tetrahedra)
    assert inside["gripper.urdf"].data.decode() == gripper_urdf(gripper)


def test_check_sums_of_the_format_hold(tmp_path: Path) -> None:
    """mcap's own readers, with validation of every check sum, accept the file; one changed byte is found."""
    from mcap.reader import make_reader
    from mcap.stream_reader import CRCValidationError, StreamReader

    path, messages = write_example(tmp_path)
    with open(path, "rb") as stream:
        indexed = make_reader(stream, validate_crcs=True)
        assert len(list(indexed.iter_messages())) == len(messages)
        assert indexed.get_summary().statistics.message_count == len(messages)
    with open(path, "rb") as stream:
        assert list(StreamReader(stream, validate_crcs=True).records)
    content = bytearray(path.read_bytes())
    content[content.index(b"cpu")] ^= 1
    path.write_bytes(content)
    with open(path, "rb") as stream, pytest.raises(CRCValidationError):
        list(StreamReader(stream, validate_crcs=True).records)


def test_definitions_are_those_that_are_installed(tmp_path: Path) -> None:
    """The text of each type in the log begins with the installed .msg file, and holds those of all its parts."""
    write_example(tmp_path)
    share = Path(sys.prefix) / "share"
    reader = LogReader(tmp_path / "run")
    list(reader)
    assert {topic.name for topic in TOPICS} == set(reader.topics)
    for topic in reader.topics.values():
        own, *parts = topic.schema.data.decode().split("=" * 80 + "\n")
        assert own.rstrip() == (share / f"{topic.type_name}.msg").read_text().rstrip()
        for part in parts:
            title, text = part.split("\n", 1)
            name = title.removeprefix("MSG: ").replace("/", "/msg/")
            assert text.rstrip() == (share / f"{name}.msg").read_text().rstrip()
