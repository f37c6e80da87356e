"""Writes a bag folder: one MCAP file as rosbag2 writes them, and its ``metadata.yaml``.

The file has the profile ``ros2``: messages in CDR, definitions as ``ros2msg`` text, the quality of service of each
topic in its channel's metadata, compressed chunks with check sums.
"""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import yaml
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.recording.attachments import Attachment
from defgrasp_ros.recording.bag_metadata import bag_metadata
from defgrasp_ros.recording.definitions import message_definition
from defgrasp_ros.recording.topic import Topic

FLUSH_INTERVAL = 0.25
"""Longest wall time that a message waits for its chunk to be written to the file [s]."""

METADATA_NAME = "defgrasp"
"""Name of the MCAP metadata record that says how the run was made."""

STATISTICS_NAME = "defgrasp_recording"
"""Name of the MCAP metadata record at the end that says how the recording went."""

MESSAGE_OVERHEAD = 64
"""Most bytes that the file holds for a message beside its data: record head, times and its entry in an index [B]."""

CHUNK_OVERHEAD = 256
"""Most bytes that the file holds for a chunk beside its records, without what each channel adds to its index [B]."""

CHUNK_SIZE = 2**20
"""Size of messages that makes a chunk full [B]."""

FOOTER_SIZE = 4096
"""Room for statistics, record of the recording, offsets and footer [B]."""


class FullLogError(RecordingError):
    """The log has reached the size limit; what is in it is complete and indexed."""


class BagWriter:
    """The bag folder ``<directory>/<name>`` with the file ``<name>_0.mcap``; for one thread.

    Args:
        directory: Folder for the bag folder; made if it is not there.
        name: Name of the bag folder, unique in ``directory``.
        topics: Every topic that will be written, with its full name.
        metadata: How the run was made; kept in the metadata record ``defgrasp``.
        attachments: Files to keep inside.
        max_size: Size that the file does not exceed [B]; 0: no limit.

    Raises:
        RecordingError: If the file cannot be made.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        topics: Sequence[Topic],
        metadata: Mapping[str, str],
        attachments: Iterable[Attachment] = (),
        max_size: int = 0,
    ) -> None:
        self.path = directory / name / f"{name}_0.mcap"
        self._topics = topics
        self._max_size = max_size
        self._last_flush = -FLUSH_INTERVAL
        self._counts: Counter[str] = Counter()
        self._start_time = self._end_time = 0
        self._pending = 0
        self._end_of_chunks = 0
        self._channels: dict[str, int] = {}
        definitions = {topic.type_name: message_definition(topic.type_name) for topic in topics}
        try:
            self.path.parent.mkdir(parents=True)
            self._stream = open(self.path, "wb")  # noqa: SIM115 - lives as long as the log
        except OSError as error:
            raise RecordingError(f"cannot make the log {self.path}: {error.strerror}") from error
        # Chunks are ended here alone, so that what is in the file and what is not is always known.
        endless = sys.maxsize
        self._writer = Writer(self._stream, endless, CompressionType.ZSTD, enable_data_crcs=True)
        try:
            self._writer.start(profile=Profile.ROS2)
            self._writer.add_metadata(METADATA_NAME, dict(metadata))
            now = time.time_ns()
            for attachment in attachments:
                self._writer.add_attachment(now, now, attachment.name, attachment.media_type, attachment.data)
            schemas = {
                type_name: self._writer.register_schema(type_name, SchemaEncoding.ROS2, definition.text.encode())
                for type_name, definition in definitions.items()
            }
            for topic in topics:
                self._channels[topic.name] = self._writer.register_channel(
                    topic.name,
                    MessageEncoding.CDR,
                    schemas[topic.type_name],
                    {
                        "offered_qos_profiles": yaml.safe_dump([topic.offered_qos_profile], sort_keys=False),
                        "topic_type_hash": definitions[topic.type_name].type_hash,
                    },
                )
            self._stream.flush()
            self._end_of_chunks = self._stream.tell()
        except OSError as error:
            raise self._abandon(error) from error
        schema_size = sum(len(definition.text) + 256 for definition in definitions.values())
        self._summary_size = FOOTER_SIZE + schema_size + 1024 * len(topics)

    @property
    def closed(self) -> bool:
        """Whether the log has ended, in whatever way."""
        return self._stream.closed

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message; it reaches the file with its chunk.

        Args:
            topic: Full name of one of the log's topics.
            data: Message in CDR.
            log_time: When it was recorded [ns since the epoch].
            publish_time: The time that it is about [ns].

        Raises:
            FullLogError: If the file would become larger than allowed; it can still be closed.
            RecordingError: If the disk is full or fails; the file then ends with its last complete chunk.
        """
        size = len(data) + MESSAGE_OVERHEAD
        if not self._has_room(size):
            self.flush()
            if not self._has_room(size):
                raise FullLogError(f"the log {self.path} has reached its largest size, {self._max_size / 1e6:g} MB")
        self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence=self._counts[topic])
        self._pending += size
        self._start_time = self._start_time or log_time
        self._end_time = log_time
        self._counts[topic] += 1
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Write the messages that wait for their chunk when they have waited long enough, or are many.

        Raises:
            RecordingError: If the disk is full or fails.
        """
        if self._pending >= CHUNK_SIZE or time.monotonic() - self._last_flush >= FLUSH_INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Write the messages that wait for their chunk.

        Raises:
            RecordingError: If the disk is full or fails.
        """
        if not self._pending:
            return
        try:
            self._writer.flush()
            self._end_of_chunks = self._stream.tell()
        except OSError as error:
            raise self._abandon(error) from error
        self._summary_size += CHUNK_OVERHEAD + 10 * len(self._topics)
        self._pending = 0
        self._last_flush = time.monotonic()

    def close(self, statistics: Mapping[str, str]) -> None:
        """Write index, statistics and the bag's ``metadata.yaml``, and close; without effect when closed already.

        Args:
            statistics: How the recording went; kept in the metadata record ``defgrasp_recording``.

        Raises:
            RecordingError: If the disk is full or fails.
        """
        if self.closed:
            return
        self.flush()
        try:
            self._writer.add_metadata(STATISTICS_NAME, dict(statistics))
            self._writer.finish()
            self._stream.close()
            self._end_of_chunks = 0
            metadata = bag_metadata(self.path.name, self._topics, self._counts, self._start_time, self._end_time)
            (self.path.parent / "metadata.yaml").write_text(yaml.safe_dump(metadata, sort_keys=False))
        except OSError as error:
            raise self._abandon(error) from error

    def _has_room(self, size: int) -> bool:
        """Whether the file stays within its limit with so many bytes more, should they not compress."""
        if not self._max_size:
            return True
        expected = self._stream.tell() + self._pending + size + CHUNK_OVERHEAD + 25 * len(self._topics)
        return expected + self._summary_size <= self._max_size

    def _abandon(self, error: OSError) -> RecordingError:
        """Close a file that can take no more, without the beginning of a chunk at its end."""
        with suppress(OSError):
            self._stream.close()
        if self._end_of_chunks:
            with suppress(OSError):
                os.truncate(self.path, self._end_of_chunks)
        return RecordingError(f"cannot write the log {self.path}: {error.strerror}")
