"""Reads the log of a run back as a whole, with all messages decoded."""

from __future__ import annotations

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
    """The decoded message, with the fields of its definition as attributes."""


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


def read_log(path: Path, *topics: str) -> LoggedRun:
    """Read an MCAP file up to its last complete record.

    Args:
        path: The MCAP file, or the bag folder that holds it.
        topics: Topics of interest, by their full names or the last part of them; none: all.

    Raises:
        RecordingError: If there is no such file, or if it is no MCAP log of ROS messages.
    """
    reader = LogReader(path)
    messages = [
        LoggedMessage(
            message.topic.name,
            message.topic.type_name,
            message.log_time,
            message.publish_time,
            reader.decode(message),
        )
        for message in reader
        if not topics or any(map(message.topic.matches, topics))
    ]
    return LoggedRun(reader.path, messages, reader.provenance, reader.attachments, reader.complete)
