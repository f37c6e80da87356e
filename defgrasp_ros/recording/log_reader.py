"""Reads the records of a log one after the other, also of one whose writer was killed or whose file was cut off."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from defgrasp_ros.errors import NotFoundError, RecordingError
from defgrasp_ros.recording.attachments import Attachment
from defgrasp_ros.recording.bag_writer import METADATA_NAME, STATISTICS_NAME

RECORD_HEAD = struct.Struct("<BQ")
"""Every MCAP record begins with its kind and the length of what follows."""

DAMAGE = (McapError, ZstdError, ValueError, KeyError, struct.error)
"""What the format's reader raises when bytes are not what they should be; a wrong check sum is a ValueError."""


@dataclass(frozen=True)
class LoggedTopic:
    """A topic of a log."""

    name: str
    type_name: str
    type_hash: str
    """RIHS01 hash of the type; empty where the log does not say."""
    qos: dict[str, Any]
    """The publisher's quality of service, in the words of rosbag2; empty where the log does not say."""
    schema: Schema
    """Definition of the type."""
    encoding: str
    """How messages are encoded; ``cdr`` in ROS 2."""

    def matches(self, name: str) -> bool:
        """Whether ``name`` means this topic: its full name, or the last parts of it."""
        return self.name == name or self.name.endswith(f"/{name}")


@dataclass(frozen=True)
class RawMessage:
    """One message of a log, still encoded."""

    topic: LoggedTopic
    log_time: int
    """When it was recorded [ns since the epoch]."""
    publish_time: int
    """The time that it is about [ns]: start of the run plus simulated time."""
    data: bytes


class LogReader:
    """Iterates over the messages of an MCAP file, in the order of recording, up to its last complete record.

    What else the file holds is known as far as it has been read; metadata, attachments and topics of a run come
    before its messages.

    Args:
        path: The MCAP file, or the bag folder that holds it.

    Raises:
        NotFoundError: If there is no such file, or none in the folder.
        RecordingError: If there are several; while iterating, if it is no MCAP log of ROS messages, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = mcap_file(path)
        self.provenance: dict[str, str] = {}
        """Versions, device and parameters of the run."""
        self.statistics: dict[str, str] = {}
        """How the recording went."""
        self.attachments: dict[str, Attachment] = {}
        """Files inside, by name."""
        self.topics: dict[str, LoggedTopic] = {}
        """Topics by name."""
        self.complete = False
        """Whether the log was closed; otherwise it holds what was written until its writer died."""

    def __iter__(self) -> Iterator[RawMessage]:
        try:
            with open(self.path, "rb") as stream, suppress(EndOfFile):  # the end of a log that was not closed
                records = CompleteRecords(stream)
                yield from self._messages(StreamReader(records, skip_magic=True, validate_crcs=True).records)
        except OSError as error:
            raise RecordingError(f"cannot read the log {self.path}: {error.strerror}") from error
        except DAMAGE as error:
            raise RecordingError(f"{self.path} is damaged, or no MCAP file: {error}") from error

    def decode(self, message: RawMessage) -> Any:
        """Return the message with the fields of its definition in the log as attributes.

        Raises:
            RecordingError: If it is no ROS 2 message.
        """
        decode = self._decoders.decoder_for(message.topic.encoding, message.topic.schema)
        if decode is None:
            raise RecordingError(f"{self.path}: topic {message.topic.name} has no ROS 2 messages")
        return decode(message.data)

    @cached_property
    def _decoders(self) -> DecoderFactory:
        return DecoderFactory()

    def _messages(self, records: Iterator[McapRecord]) -> Iterator[RawMessage]:
        schemas: dict[int, Schema] = {}
        topics: dict[int, LoggedTopic] = {}
        for record in records:
            match record:
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    topics[record.id] = _topic(record, schemas[record.schema_id])
                    self.topics[record.topic] = topics[record.id]
                case Metadata(name=name, metadata=values) if name == METADATA_NAME:
                    self.provenance = values
                case Metadata(name=name, metadata=values) if name == STATISTICS_NAME:
                    self.statistics = values
                case AttachmentRecord():
                    self.attachments[record.name] = Attachment(record.name, record.media_type, record.data)
                case Message():
                    topic = topics[record.channel_id]
                    yield RawMessage(topic, record.log_time, record.publish_time, record.data)
                case Footer():
                    self.complete = True


class CompleteRecords:
    """A file's content after its magic number, up to the end of the last complete record.

    Args:
        stream: The file.

    Raises:
        InvalidMagic: If it is no MCAP file.
    """

    def __init__(self, stream: BinaryIO) -> None:
        start = stream.read(len(MCAP0_MAGIC))
        if not MCAP0_MAGIC.startswith(start):
            raise InvalidMagic(start)
        size = stream.seek(0, 2)
        self._end = len(start)
        while self._end + RECORD_HEAD.size <= size:
            stream.seek(self._end)
            _, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
            if self._end + RECORD_HEAD.size + length > size:
                break
            self._end += RECORD_HEAD.size + length
        stream.seek(len(start))
        self._stream = stream

    def read(self, length: int) -> bytes:
        """Return the next bytes; fewer, or none, at the end."""
        return self._stream.read(min(length, self._end - self._stream.tell()))


def mcap_file(path: Path) -> Path:
    """Return the MCAP file of a log, given by itself or by its bag folder.

    Raises:
        NotFoundError: If there is none.
        RecordingError: If there is more than one.
    """
    if not path.exists():
        raise NotFoundError(f"there is no log {path}; give the bag folder of a run, or the .mcap file in it")
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if not files:
        raise NotFoundError(f"the folder {path} holds no .mcap file; give the bag folder of one run")
    if len(files) > 1:
        raise RecordingError(f"the folder {path} holds {len(files)} .mcap files; name one of them")
    return files[0]


def _topic(channel: Channel, schema: Schema) -> LoggedTopic:
    qos = _first_profile(channel.metadata.get("offered_qos_profiles", ""))
    type_hash = channel.metadata.get("topic_type_hash", "")
    return LoggedTopic(channel.topic, schema.name, type_hash, qos, schema, channel.message_encoding)


@cache
def _first_profile(text: str) -> dict[str, Any]:
    return (yaml.safe_load(text) or [{}])[0]
