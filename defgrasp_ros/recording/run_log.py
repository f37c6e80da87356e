"""Writes the log of one run: an MCAP file inside a bag folder, as rosbag2 writes them.

The file has the profile ``ros2``: messages in CDR, definitions as ``ros2msg`` text, the quality of service of each
topic in its channel's metadata. It is cut into small compressed chunks that reach the file within a fraction of a
second, so that a process that is killed loses no more than that; what is there can be read with ``read_log``.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import yaml
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.recording.bag_metadata import bag_metadata
from defgrasp_ros.recording.cdr import encode_cdr
from defgrasp_ros.recording.definitions import MessageDefinition, message_definition
from defgrasp_ros.recording.topic import Topic

FLUSH_INTERVAL = 0.25
"""Longest wall time between two messages of which the first is not yet in the file [s]."""

METADATA_NAME = "defgrasp"
"""Name of the MCAP metadata record that says how the run was made."""


class RunLog:
    """The log ``<directory>/<run_id>/<run_id>_0.mcap`` of one run; not for several threads at once.

    Args:
        directory: Folder for the bag folders; made if it is not there.
        run_id: Name of the run, unique in ``directory``.
        topics: Every topic that will be written, with its full name.
        provenance: How the run was made (versions, device, parameters); kept in the metadata record ``defgrasp``.

    Raises:
        RecordingError: If the file cannot be made.
    """

    def __init__(self, directory: Path, run_id: str, topics: Sequence[Topic], provenance: Mapping[str, str]) -> None:
        self.path = directory / run_id / f"{run_id}_0.mcap"
        self._topics = topics
        self._last_flush = -FLUSH_INTERVAL
        self._counts: Counter[str] = Counter()
        self._start_time = self._end_time = 0
        self._channels: dict[str, int] = {}
        definitions = {topic.name: message_definition(topic.type_name) for topic in topics}
        try:
            self.path.parent.mkdir(parents=True)
            self._stream = open(self.path, "wb")  # noqa: SIM115 - lives as long as the log
        except OSError as error:
            raise RecordingError(f"cannot make the log {self.path}: {error.strerror}") from error
        self._writer = Writer(self._stream, compression=CompressionType.ZSTD)
        try:
            self._writer.start(profile=Profile.ROS2)
            self._writer.add_metadata(METADATA_NAME, dict(provenance))
            for topic in topics:
                self._register(topic, definitions[topic.name])
            self._stream.flush()
        except OSError as error:
            raise self._abandon(error) from error

    def write(self, topic: str, message: object, publish_time: int) -> None:
        """Append a message.

        Args:
            topic: Full name of one of the log's topics.
            message: Message of that topic's type.
            publish_time: Time that the message is about [ns], usually its header's stamp; the time at which it is
                recorded is now.

        Raises:
            RecordingError: If the disk is full or fails; the log is then closed.
        """
        if self._stream.closed:
            raise RecordingError(f"the log {self.path} is closed")
        data = encode_cdr(message)
        log_time = time.time_ns()
        try:
            self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence=self._counts[topic])
            if time.monotonic() - self._last_flush >= FLUSH_INTERVAL:
                self._writer.flush()
                self._last_flush = time.monotonic()
        except OSError as error:
            raise self._abandon(error) from error
        self._start_time = self._start_time or log_time
        self._end_time = log_time
        self._counts[topic] += 1

    def close(self) -> None:
        """Write index, statistics and the bag's ``metadata.yaml``, and close; without effect when closed already.

        Raises:
            RecordingError: If the disk is full or fails.
        """
        if self._stream.closed:
            return
        try:
            self._writer.finish()
            self._stream.close()
            metadata = bag_metadata(self.path.name, self._topics, self._counts, self._start_time, self._end_time)
            (self.path.parent / "metadata.yaml").write_text(yaml.safe_dump(metadata, sort_keys=False))
        except OSError as error:
            raise self._abandon(error) from error

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _register(self, topic: Topic, definition: MessageDefinition) -> None:
        schema = self._writer.register_schema(topic.type_name, SchemaEncoding.ROS2, definition.text.encode())
        channel_metadata = {
            "offered_qos_profiles": yaml.safe_dump([topic.offered_qos_profile], sort_keys=False),
            "topic_type_hash": definition.type_hash,
        }
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, MessageEncoding.CDR, schema, channel_metadata
        )

    def _abandon(self, error: OSError) -> RecordingError:
        with suppress(OSError):
            self._stream.close()
        return RecordingError(f"cannot write the log {self.path}: {error.strerror}")
