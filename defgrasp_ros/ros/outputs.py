"""Where the messages of a run go: to the node's topics, and into the log of the run."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from threading import Lock

from rclpy.node import Node

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.recording import Attachment, LogStatistics, RunLog, Topic
from defgrasp_ros.ros.topics import CLOCK, LOGGED, PUBLISHED, REQUEST, qos_profile, relative_name


class Outputs:
    """Publishers of all topics, and the log of the present run if there is one; may be used from several threads.

    The clock has a publisher only where the parameter ``publish.clock`` is set at the start.
    A log that fails ends, but never the run.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._full_names = {topic: node.resolve_topic_name(topic.name) for topic in LOGGED}
        self._publishers = {
            topic: node.create_publisher(topic.message_class, topic.name, qos_profile(topic)) for topic in PUBLISHED
        }
        if node.get_parameter("publish.clock").value:
            self._publishers[CLOCK] = node.create_publisher(CLOCK.message_class, CLOCK.name, qos_profile(CLOCK))
        self._lock = Lock()
        self._log: RunLog | None = None
        self._logged: frozenset[Topic] = frozenset()
        self._problem = ""

    def start_log(
        self,
        directory: Path,
        run_id: str,
        provenance: Mapping[str, str],
        attachments: Iterable[Attachment] = (),
        *,
        topics: Collection[str] = (),
        max_size: int = 0,
    ) -> None:
        """Open the log of a run.

        Args:
            directory: Folder of the logs.
            run_id: Name of the run.
            provenance: How the run is made.
            attachments: Files to keep inside.
            topics: Relative names of the topics to be logged; none: all. The request always is.
            max_size: Size that the log does not exceed [B]; 0: no limit.
        """
        chosen = [topic for topic in LOGGED if not topics or topic is REQUEST or relative_name(topic) in topics]
        full = [dataclasses.replace(topic, name=self._full_names[topic]) for topic in chosen]
        with self._lock:
            try:
                self._log = RunLog(directory, run_id, full, provenance, attachments, max_size)
                self._logged = frozenset(chosen)
            except RecordingError as error:
                self._give_up(f"not logged: {error}")

    def end_log(self) -> tuple[Path | None, str]:
        """Close the log of the run.

        Returns:
            Where the log is, None if there is none; and what is wrong with it, empty if it is complete or was not
            asked for.
        """
        with self._lock:
            log = self._log
            try:
                if log:
                    log.close()
            except RecordingError as error:
                self._give_up(f"the log is not complete: {error}")
            problem = self._problem
            self._log, self._logged, self._problem = None, frozenset(), ""
        return (log.path if log else None), problem

    @property
    def log_statistics(self) -> LogStatistics | None:
        """How the recording of the present run goes; None if there is none."""
        log = self._log
        return log.statistics if log else None

    @property
    def log_problem(self) -> str:
        """What is wrong with the log of the present run; empty if nothing is."""
        return self._problem

    def wanted(self, topic: Topic) -> bool:
        """Whether somebody listens to a topic, or the log does."""
        is_heard = topic in self._publishers and self._publishers[topic].get_subscription_count() > 0
        return is_heard or self.is_logged(topic)

    def is_logged(self, topic: Topic) -> bool:
        """Whether the log of the present run takes the messages of a topic."""
        return topic in self._logged

    def send(self, topic: Topic, message: object, time: int) -> None:
        """Publish a message and log it.

        Args:
            topic: One of the published topics.
            message: Message of its type.
            time: What the message is about: start of the run plus simulated time [ns].
        """
        self.publish(topic, message)
        self.log(topic, message, time)

    def publish(self, topic: Topic, message: object) -> None:
        """Publish a message without logging it; one that nobody hears now or later costs nothing."""
        publisher = self._publishers[topic]
        if topic.latched or publisher.get_subscription_count() > 0:
            publisher.publish(message)

    def log(self, topic: Topic, message: object, time: int) -> None:
        """Write a message into the log only; without effect where there is no log, or not for this topic.

        Waits while the disk is too slow for what is being logged.
        """
        with self._lock:
            try:
                if self._log and topic in self._logged:
                    self._log.write(self._full_names[topic], message, time)
            except RecordingError as error:
                self._logged = frozenset()
                self._give_up(f"the log is not complete: {error}")

    def _give_up(self, problem: str) -> None:
        if not self._problem:
            self._problem = problem
            self._logger.warning(f"the run goes on; {problem}")
