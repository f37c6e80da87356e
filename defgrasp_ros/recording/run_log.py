"""Writes the log of one run in the background, so that a process that is killed loses only a fraction of a second.

Messages are encoded where they come from, then wait in memory for the thread that compresses and writes. When more
wait than fits, the caller waits, too: nothing is dropped, and memory stays bounded.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import NamedTuple

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.recording import bag_writer
from defgrasp_ros.recording.attachments import Attachment
from defgrasp_ros.recording.bag_writer import BagWriter, FullLogError
from defgrasp_ros.recording.byte_queue import ByteQueue
from defgrasp_ros.recording.cdr import encode_cdr
from defgrasp_ros.recording.topic import Topic

QUEUE_SIZE = 64 * 2**20
"""Encoded messages that may wait to be written [B]."""


class EncodedMessage(NamedTuple):
    """A message on its way to the file; times as of ``BagWriter.write``."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int


@dataclass(frozen=True)
class LogStatistics:
    """How the recording goes."""

    message_count: int
    """Messages taken so far."""
    byte_count: int
    """Their size before compression [B]."""
    queued_bytes: int
    """What of it waits to be written [B]."""
    waiting_time: float
    """How long the callers have waited for the disk [s]."""


class RunLog:
    """The log ``<directory>/<run_id>/<run_id>_0.mcap`` of one run; ``write`` is not for several threads at once.

    Args:
        directory: Folder for the bag folders; made if it is not there.
        run_id: Name of the run, unique in ``directory``.
        topics: Every topic that will be written, with its full name.
        provenance: How the run was made (versions, device, parameters); kept in the metadata record ``defgrasp``.
        attachments: Files to keep inside.
        max_size: Size that the file does not exceed [B]; 0: no limit.

    Raises:
        RecordingError: If the file cannot be made.
    """

    def __init__(
        self,
        directory: Path,
        run_id: str,
        topics: Sequence[Topic],
        provenance: Mapping[str, str],
        attachments: Iterable[Attachment] = (),
        max_size: int = 0,
    ) -> None:
        self._bag = BagWriter(directory, run_id, topics, provenance, attachments, max_size)
        self._queue: ByteQueue[EncodedMessage] = ByteQueue(QUEUE_SIZE)
        self._problem: RecordingError | None = None
        self._message_count = self._byte_count = 0
        self._last_time = 0
        self._writer = Thread(target=self._write_all, name="recording", daemon=True)
        self._writer.start()

    @property
    def path(self) -> Path:
        """The MCAP file."""
        return self._bag.path

    @property
    def statistics(self) -> LogStatistics:
        """How the recording goes; from any thread."""
        return LogStatistics(self._message_count, self._byte_count, self._queue.size, self._queue.waiting_time)

    def write(self, topic: str, message: object, publish_time: int) -> None:
        """Append a message; waits while too many others wait to be written. The message may be changed afterwards.

        Args:
            topic: Full name of one of the log's topics.
            message: Message of that topic's type.
            publish_time: Time that the message is about [ns], usually its header's stamp; the time at which it is
                recorded is now.

        Raises:
            RecordingError: If this or an earlier message could not be written: the disk is full or fails, or the file
                has reached its largest size. The log has then ended.
        """
        data = encode_cdr(message)
        self._last_time = log_time = max(time.time_ns(), self._last_time)  # the clock can be set back
        if not self._queue.put(EncodedMessage(topic, data, log_time, publish_time), len(data)):
            raise self._problem or RecordingError(f"the log {self.path} is closed")
        self._message_count += 1
        self._byte_count += len(data)

    def close(self) -> None:
        """Write what waits, index, statistics and the bag's ``metadata.yaml``; without effect when closed already.

        Raises:
            RecordingError: If not everything could be written.
        """
        self._queue.close()
        self._writer.join()
        if self._problem:
            raise self._problem

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_all(self) -> None:
        try:
            try:
                self._write_queue()
            except FullLogError as error:
                self._end(error)
            self._bag.close({"waiting_time": f"{self._queue.waiting_time:.3f}"})
        except RecordingError as error:
            self._end(error)
        except Exception as error:  # whatever it is, nobody may wait for this thread for ever
            self._end(RecordingError(f"cannot write the log {self.path}: {type(error).__name__}: {error}"))

    def _write_queue(self) -> None:
        while not self._queue.finished:
            message = self._queue.get(bag_writer.FLUSH_INTERVAL)
            if message:
                self._bag.write(*message)
            else:
                self._bag.flush_if_due()

    def _end(self, problem: RecordingError) -> None:
        self._problem = problem
        self._queue.close(discard=True)
