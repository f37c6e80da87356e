"""Reads the log of a run back, also one whose writer was killed or whose file was cut off."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.records import Channel, Footer, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.recording.run_log import METADATA_NAME

RECORD_HEAD = struct.Struct("<BQ")
"""Every MCAP record begins with its kind and the length of what follows."""


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
    complete: bool = False
    """Whether the log was closed; otherwise it holds what was written until its writer died."""

    def on(self, topic: str) -> list[Any]:
        """Return the messages of a topic, given by its full name or by the last part of it."""
        return [entry.message for entry in self.messages if entry.topic == topic or entry.topic.endswith(f"/{topic}")]


def read_log(path: Path) -> LoggedRun:
    """Read an MCAP file up to its last complete record.

    Args:
        path: The MCAP file, or the bag folder that holds it.

    Raises:
        RecordingError: If there is no such file, or if it is no MCAP log of ROS messages.
    """
    if path.is_dir():
        files = sorted(path.glob("*.mcap"))
        if len(files) != 1:
            raise RecordingError(f"{path} holds {len(files)} .mcap files, expected one; name the file")
        path = files[0]
    run = LoggedRun(path)
    try:
        with open(path, "rb") as stream:
            records = _complete_records(stream)
        with suppress(EndOfFile):  # the end of a log that was not closed
            _read_records(StreamReader(records, skip_magic=True, validate_crcs=True), run)
    except OSError as error:
        raise RecordingError(f"cannot read the log {path}: {error.strerror}") from error
    except (McapError, CRCValidationError, ZstdError) as error:
        raise RecordingError(f"{path} is damaged, or no MCAP file: {error}") from error
    return run


def _complete_records(stream: BinaryIO) -> BytesIO:
    """Return the file's content after its magic number, up to the end of the last complete record."""
    content = stream.read()
    if not (content.startswith(MCAP0_MAGIC) or MCAP0_MAGIC.startswith(content)):
        raise InvalidMagic(content[: len(MCAP0_MAGIC)])
    start = end = len(MCAP0_MAGIC)
    while end + RECORD_HEAD.size <= len(content):
        _, length = RECORD_HEAD.unpack_from(content, end)
        if end + RECORD_HEAD.size + length > len(content):
            break
        end += RECORD_HEAD.size + length
    return BytesIO(content[start:end])


def _read_records(reader: StreamReader, run: LoggedRun) -> None:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders = DecoderFactory()
    for record in reader.records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata) and record.name == METADATA_NAME:
            run.provenance = record.metadata
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            schema = schemas[channel.schema_id]
            decode = decoders.decoder_for(channel.message_encoding, schema)
            if decode is None:
                raise RecordingError(f"{run.path}: topic {channel.topic} has no ROS 2 messages")
            run.messages.append(
                LoggedMessage(channel.topic, schema.name, record.log_time, record.publish_time, decode(record.data))
            )
        elif isinstance(record, Footer):
            run.complete = True
