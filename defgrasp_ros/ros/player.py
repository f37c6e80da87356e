"""Publishes the messages of a log again, with the recorded quality of service, in the recorded rhythm."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from defgrasp_ros.errors import InvalidOptionsError, RecordingError
from defgrasp_ros.recording.definitions import message_definition
from defgrasp_ros.recording.log_reader import LoggedTopic, LogReader, RawMessage
from defgrasp_ros.recording.log_summary import LogSummary, summarize_log
from defgrasp_ros.recording.topic import NANOSECONDS, UNLIMITED, Topic
from defgrasp_ros.ros.fields import time_message
from defgrasp_ros.ros.playback_timer import PlaybackTimer
from defgrasp_ros.ros.topics import qos_profile

CLOCK = Topic("/clock", Clock, depth=1, reliable=False)
"""The log time of a replay."""

CLOCK_INTERVAL = 0.025
"""Wall time between two messages on ``/clock`` [s]."""

SETTLING_TIME = 0.5
"""When no further subscriber was found for so long, all are taken to be there [s]."""

OVERTAKING_TIME = 0.2
"""How long a message may wait until the one that it would replace in a publisher's history has been received [s]."""

ACKNOWLEDGE_TIME = 5.0
"""How long subscribers may take at the end to receive what is still under way [s]."""


class Player:
    """Replays one log.

    Messages are published as they were recorded, byte by byte; a topic whose type is not installed here, or in another
    version, is left out.

    Args:
        node: Gets the publishers.
        log: The MCAP file, or its bag folder.
        topics: Names of the topics to be replayed, full or their last parts; none: all.
        with_clock: Whether the log time is published on ``/clock``; a clock in the log itself is then left out.

    Raises:
        NotFoundError: If there is no such log.
        RecordingError: If the log cannot be read, or if nothing of it can be replayed.
        InvalidOptionsError: If the log has no topic of a name.
    """

    def __init__(self, node: Node, log: Path, topics: Sequence[str] = (), *, with_clock: bool = False) -> None:
        self.summary: LogSummary = summarize_log(log)
        self.left_out: list[str] = []
        """Topics that cannot be replayed, and why."""
        self._node = node
        self._log = log
        self._publishers: dict[str, Publisher] = {}
        self._depths: dict[str, int] = {}
        self._sent: Counter[str] = Counter()
        self._clock = node.create_publisher(Clock, CLOCK.name, qos_profile(CLOCK)) if with_clock else None
        self._last_clock = 0.0
        for topic in self._chosen(topics):
            if with_clock and topic.name == CLOCK.name:
                continue
            try:
                self._advertise(replayed_topic(topic))
            except RecordingError as error:
                self.left_out.append(f"{topic.name}: {error}")
        if not self._publishers:
            raise RecordingError("; ".join([f"{log} has nothing that can be replayed here", *self.left_out]))

    def wait_for_subscribers(self, longest: float) -> None:
        """Wait until subscribers that are there can receive: until some are connected, and no more come.

        Args:
            longest: How long to look for them [s]; they can take 3 s to answer.
        """
        end = time.monotonic() + longest
        found, since = self._connections(), time.monotonic()
        while (now := time.monotonic()) < end:
            if (present := self._connections()) != found:
                found, since = present, now
            is_connected = any(found) and all(connected >= there for there, connected in found)
            if is_connected and now - since >= SETTLING_TIME:
                return
            time.sleep(0.02)

    def play(self, timer: PlaybackTimer, start: int, on_position: Callable[[int], None]) -> int:
        """Publish from log time ``start`` [ns] to the end.

        Of latched topics, what a subscriber would still have had at the start comes first.

        Args:
            timer: Tells the time; is set to ``start``.
            start: Where to begin [ns].
            on_position: Is told the log time now and then [ns].

        Returns:
            Number of published messages.
        """

        def on_tick(position: int) -> None:
            self._publish_clock(position)
            on_position(position)

        count = 0
        timer.restart(start)
        for message in self._from(start):
            timer.wait_until(message.log_time, on_tick)
            self._publish(message)
            count += 1
            on_position(message.log_time)
        return count

    def finish(self) -> None:
        """Wait until everything has been received by those who are there."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIME))

    def _publish(self, message: RawMessage) -> None:
        """Publish when no message that somebody still waits for is lost by it; the log holds bursts, too."""
        name = message.topic.name
        publisher = self._publishers[name]
        if self._sent[name] >= publisher.qos_profile.depth:
            publisher.wait_for_all_acked(Duration(seconds=OVERTAKING_TIME))
            self._sent[name] = 0
        publisher.publish(message.data)
        self._sent[name] += 1

    def _chosen(self, names: Sequence[str]) -> list[LoggedTopic]:
        topics = self.summary.topics
        for name in names:
            if not any(topic.matches(name) for topic in topics):
                known = ", ".join(topic.name for topic in topics) or "none"
                raise InvalidOptionsError(f"the log has no topic '{name}'; it has: {known}")
        return [topic for topic in topics if not names or any(map(topic.matches, names))]

    def _advertise(self, topic: Topic) -> None:
        self._publishers[topic.name] = self._node.create_publisher(topic.message_class, topic.name, qos_profile(topic))
        if topic.latched:
            self._depths[topic.name] = topic.depth

    def _connections(self) -> list[tuple[int, int]]:
        """For each topic with subscribers how many are known, and how many of them can receive."""
        numbers = [
            (self._node.count_subscribers(name), publisher.get_subscription_count())
            for name, publisher in self._publishers.items()
        ]
        return [number for number in numbers if any(number)]

    def _from(self, start: int) -> Iterator[RawMessage]:
        """The messages to be published, first the latched ones from before the start."""
        kept = {name: deque[RawMessage](maxlen=depth) for name, depth in self._depths.items()}
        for message in LogReader(self._log):
            name = message.topic.name
            if name not in self._publishers:
                continue
            if message.log_time < start:
                if name in kept:
                    kept[name].append(message)
                continue
            if kept:
                yield from sorted((each for queue in kept.values() for each in queue), key=lambda each: each.log_time)
                kept.clear()
            yield message

    def _publish_clock(self, position: int) -> None:
        now = time.monotonic()
        if self._clock and now - self._last_clock >= CLOCK_INTERVAL:
            self._clock.publish(Clock(clock=time_message(position)))
            self._last_clock = now


def replayed_topic(logged: LoggedTopic) -> Topic:
    """Return a logged topic with its message class and its quality of service.

    Raises:
        RecordingError: If the type is not installed, or in another version.
    """
    package, _, name = logged.type_name.split("/")
    try:
        message_class = getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise RecordingError(f"type {logged.type_name} is not installed") from error
    if logged.type_hash and message_definition(logged.type_name).type_hash != logged.type_hash:
        raise RecordingError(f"type {logged.type_name} is installed in another version than that of the log")
    qos = logged.qos
    return Topic(
        logged.name,
        message_class,
        depth=int(qos.get("depth", 10)),
        latched=qos.get("durability") == "transient_local",
        reliable=qos.get("reliability") != "best_effort",
        lease=_lease(qos.get("liveliness_lease_duration", UNLIMITED)),
    )


def _lease(duration: dict[str, int]) -> float:
    """Return a duration in the words of rosbag2 as that of a topic [s]."""
    return 0.0 if duration == UNLIMITED else duration["sec"] + duration["nsec"] / NANOSECONDS


def log_time_at(summary: LogSummary, offset: float) -> int:
    """Return the log time [ns] at an offset from its beginning [s].

    Raises:
        InvalidOptionsError: If the log is shorter.
    """
    if not 0.0 <= offset <= summary.duration:
        raise InvalidOptionsError(f"start = {offset:g} s is outside of the log, which lasts {summary.duration:.3f} s")
    return summary.start_time + round(offset * NANOSECONDS)
