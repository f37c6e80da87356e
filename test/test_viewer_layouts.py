"""The layouts for Foxglove and RViz: they can be read, and show only topics that the evaluator has."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from defgrasp_ros.configuration import config_file  # noqa: E402
from defgrasp_ros.ros import topics  # noqa: E402

NODE = "/defgrasp_evaluator"
TOPICS = {topic.name.replace("~", NODE): topic for topic in topics.PUBLISHED}
MESSAGES = {
    "MarkerArray": "MarkerArray",
    "PointCloud2": "PointCloud2",
    "RobotModel": "String",
    "Wrench": "WrenchStamped",
}
"""Displays of RViz, and the messages that they take."""


def strings(content: Any) -> Iterator[str]:
    """Yield every text in nested lists and mappings, keys too."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from (str(key), *strings(value))
    elif isinstance(content, list):
        for value in content:
            yield from strings(value)
    elif isinstance(content, str):
        yield content


def topics_of(content: Any) -> set[str]:
    """The evaluator's topics in a layout, without paths into their messages."""
    return {re.split(r"[.\[]", text)[0] for text in strings(content) if text.startswith(NODE)}


@pytest.fixture(scope="module")
def foxglove() -> dict:
    return json.loads(config_file("foxglove_layout.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def displays() -> list[dict]:
    content = yaml.safe_load(config_file("defgrasp.rviz").read_text(encoding="utf-8"))
    assert content["Visualization Manager"]["Global Options"]["Fixed Frame"] == "world"
    return content["Visualization Manager"]["Displays"]


def test_every_topic_is_one_of_the_evaluator(foxglove, displays):
    """No panel waits for a topic that is never published."""
    assert topics_of(foxglove) <= set(TOPICS)
    assert topics_of(displays) <= set(TOPICS)
    assert len(topics_of(foxglove)) >= 8 and len(topics_of(displays)) >= 5


def test_every_panel_of_foxglove_is_placed(foxglove):
    """Panels that are configured are in the layout, and the other way round."""
    tabs = [tab["layout"] for panel in foxglove["configById"].values() for tab in panel.get("tabs", [])]
    placed = [text for text in strings(foxglove["layout"]) if "!" in text] + tabs
    assert sorted(placed) == sorted(foxglove["configById"])


def test_paths_of_foxglove_lead_to_fields(foxglove):
    """What is plotted is a field of the topic's message."""
    paths = [path["value"] for panel in foxglove["configById"].values() for path in panel.get("paths", [])]
    assert len(paths) >= 7
    for path in paths:
        topic, fields = path.split(".", 1)
        message = TOPICS[topic].message_class
        for name in re.sub(r"\[\d+\]", "", fields).split("."):
            kind = message.get_fields_and_field_types()[name]
            base = re.sub(r"^sequence<([^,>]+).*>$", r"\1", kind)
            if "/" in base:
                package, class_name = base.split("/")
                message = getattr(__import__(f"{package}.msg", fromlist=["msg"]), class_name)


def test_displays_of_rviz_fit_messages_and_durability(displays):
    """A display takes the topic's message, and gets the last one where the topic keeps it."""
    for display in displays:
        name = display["Class"].split("/")[1]
        if name not in MESSAGES:
            continue
        setting = display.get("Topic") or display["Description Topic"]
        topic = TOPICS[setting["Value"]]
        assert topic.message_class.__name__ == MESSAGES[name]
        assert setting["Durability Policy"] == ("Transient Local" if topic.latched else "Volatile")
