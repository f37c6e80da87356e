"""A recorded topic and the description of its quality of service that players of bags need."""

from __future__ import annotations

from dataclasses import dataclass

from defgrasp_ros.recording.definitions import type_name_of

NANOSECONDS = 1_000_000_000
"""In a second."""

UNLIMITED = {"sec": 9223372036, "nsec": 854775807}
"""The duration that ROS takes for "no limit" (2^63 - 1 ns)."""


@dataclass(frozen=True)
class Topic:
    """A topic with the quality of service with which it is published.

    Args:
        name: Full name, or name relative to the node.
        message_class: Message class, e.g. ``sensor_msgs.msg.JointState``.
        depth: How many messages the publisher keeps.
        latched: Whether a late subscriber gets the kept messages (durability ``transient_local``).
        reliable: Whether a lost message is sent again; else best effort.
        lease: Time without a sign of life after which subscribers take the publisher for dead [s]; 0: for ever.
        description: What is on it, for people.
    """

    name: str
    message_class: type
    depth: int
    latched: bool = False
    reliable: bool = True
    lease: float = 0.0
    description: str = ""

    @property
    def type_name(self) -> str:
        """Full message type, e.g. ``sensor_msgs/msg/JointState``."""
        return type_name_of(self.message_class)

    @property
    def offered_qos_profile(self) -> dict:
        """The publisher's quality of service, in the words of a rosbag2 metadata file of version 9."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": "reliable" if self.reliable else "best_effort",
            "durability": "transient_local" if self.latched else "volatile",
            "deadline": dict(UNLIMITED),
            "lifespan": dict(UNLIMITED),
            "liveliness": "automatic",
            "liveliness_lease_duration": self._lease_words,
            "avoid_ros_namespace_conventions": False,
        }

    @property
    def _lease_words(self) -> dict[str, int]:
        seconds, nanoseconds = divmod(round(self.lease * NANOSECONDS), NANOSECONDS)
        return {"sec": seconds, "nsec": nanoseconds} if self.lease else dict(UNLIMITED)
