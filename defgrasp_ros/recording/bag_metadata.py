"""The ``metadata.yaml`` of a rosbag2 bag folder, version 9 (ROS 2 Jazzy)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from defgrasp_ros.recording.definitions import message_definition
from defgrasp_ros.recording.topic import Topic

VERSION = 9
ROS_DISTRO = "jazzy"


def bag_metadata(
    file_name: str, topics: Sequence[Topic], counts: Mapping[str, int], start_time: int, end_time: int
) -> dict:
    """Describe a bag of one MCAP file.

    Args:
        file_name: Name of the MCAP file in the bag folder.
        topics: Topics of the bag.
        counts: Messages per topic name [-].
        start_time: Time at which the first message was recorded [ns since the epoch].
        end_time: The same of the last message [ns since the epoch].
    """
    extent = {
        "starting_time": {"nanoseconds_since_epoch": start_time},
        "duration": {"nanoseconds": end_time - start_time},
        "message_count": sum(counts.values()),
    }
    return {
        "rosbag2_bagfile_information": {
            "version": VERSION,
            "storage_identifier": "mcap",
            **extent,
            "topics_with_message_count": [
                {"topic_metadata": _topic_metadata(topic), "message_count": counts.get(topic.name, 0)}
                for topic in topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file_name],
            "files": [{"path": file_name, **extent}],
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }
    }


def _topic_metadata(topic: Topic) -> dict:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": [topic.offered_qos_profile],
        "type_description_hash": message_definition(topic.type_name).type_hash,
    }
