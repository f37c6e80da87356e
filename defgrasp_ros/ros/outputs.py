"""Where the messages of a run go: to the node's topics, and into the log of the run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from threading import Lock

from rclpy.node import Node

from defgrasp_ros.errors import RecordingError
from defgrasp_ros.recording import RunLog, Topic
from defgrasp_ros.ros.topics import CLOCK, LOGGED, PUBLISHED, qos_profile


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
        self._problem = ""

    def start_log(self, directory: Path, run_id: str, provenance: dict[str, str]) -> None:
        """Open the log of a run."""
        topics = [dataclasses.replace(topic, name=name) for topic, name in self._full_names.items()]
        with self._lock:
            try:
                self._log = RunLog(directory, run_id, topics, provenance)
            except RecordingError as error:
                self._give_up(error)

    def end_log(self) -> tuple[Path | None, str]:
        """Close the log of the run.

        Returns:
            Where the complete log is, None if there is none; and why not, if one was asked for.
        """
        with self._lock:
            path = self._log and self._log.path
            try:
                if self._log:
                    self._log.close()
            except RecordingError as error:
                self._give_up(error)
            problem = self._problem
            self._log, self._problem = None, ""
        return (None if problem else path), problem

    def wanted(self, topic: Topic) -> bool:
        """Whether somebody listens to a topic, or the log does."""
        is_heard = topic in self._publishers and self._publishers[topic].get_subscription_count() > 0
        return is_heard or (self._log is not None and topic in self._full_names)

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
        """Write a message into the log only; without effect where there is no log."""
        with self._lock:
            try:
                if self._log:
                    self._log.write(self._full_names[topic], message, time)
            except RecordingError as error:
                self._give_up(error)

    def _give_up(self, error: RecordingError) -> None:
        self._log = None
        self._problem = str(error)
        self._logger.warning(f"the run goes on without its log: {error}")
