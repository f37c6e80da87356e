"""Reads the log of a run back as a whole, with all messages decoded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from defgrasp_ros.recording.attachments import Attachment
from defgrasp_ros.recording.log_reader import LogReader


@dataclass(frozen=True)
class LoggedMessage:
    """One message of a log."""

    topic: str
    type_name: str
    log_time: int
    """When it was recorded [ns since the epoch]."""
    publish_time: int
    """The time that it is about [ns]: start of the run plus simulated time."""
    message: Any
    """The decoded message, with the fields of its definition as attributes; or what it was converted to."""


@dataclass
class LoggedRun:
    """Everything that could be read of a log, in the order of recording."""

    path: Path
    messages: list[LoggedMessage] = field(default_factory=list)
    provenance: dict[str, str] = field(default_factory=dict)
    """Versions, device and parameters of the run; empty if the file ends before them."""
    attachments: dict[str, Attachment] = field(default_factory=dict)
    """Files inside by name: the object's tetrahedra, the gripper."""
    complete: bool = False
    """Whether the log was closed; otherwise it holds what was written until its writer died."""

    def on(self, topic: str) -> list[Any]:
        """Return the messages of a topic, given by its full name or by the last part of it."""
        return [entry.message for entry in self.messages if entry.topic == topic or entry.topic.endswith(f"/{topic}")]


def read_log(path: Path, *topics: str, convert: Mapping[str, Callable[[Any], Any]] | None = None) -> LoggedRun:
    """Read an MCAP file up to its last complete record.

    Args:
        path: The MCAP file, or the bag folder that holds it.
        topics: Topics of interest, by their full names or the last part of them; none: all.
        convert: What is kept instead of the messages of a topic, by the last part of its name. A decoded message holds
            numbers in lists, eight times as large as in the file.

    Raises:
        NotFoundError: If there is no such file.
        RecordingError: If it is no MCAP log of ROS messages.
    """
    reader = LogReader(path)
    messages = []
    for raw in reader:
        topic = raw.topic
        if not topics or any(map(topic.matches, topics)):
            message = reader.decode(raw)
            if into := convert and convert.get(topic.name.rpartition("/")[2]):
                message = into(message)
            messages.append(LoggedMessage(topic.name, topic.type_name, raw.log_time, raw.publish_time, message))
    return LoggedRun(reader.path, messages, reader.provenance, reader.attachments, reader.complete)
