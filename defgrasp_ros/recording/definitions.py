"""Definition texts and hashes of message types, from the share folders of the installed interface packages."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from defgrasp_ros.errors import RecordingError

SEPARATOR = "=" * 80


@dataclass(frozen=True)
class MessageDefinition:
    """What a log says about a message type, so that it can be read without the interface package."""

    type_name: str
    """Full name, e.g. ``sensor_msgs/msg/JointState``."""
    text: str
    """Definition in the ``ros2msg`` encoding: the type itself, then every type it is made of, each after 80 ``=``
    and a line ``MSG: package/Name``."""
    type_hash: str
    """RIHS01 hash of the type."""


def type_name_of(message: object) -> str:
    """Return the full type name of a message or message class, e.g. ``sensor_msgs/msg/JointState``."""
    message_class = message if isinstance(message, type) else type(message)
    return f"{message_class.__module__.split('.')[0]}/msg/{message_class.__name__}"


@cache
def message_definition(type_name: str) -> MessageDefinition:
    """Read the definition of a message type.

    Raises:
        RecordingError: If the interface package is not installed.
    """
    description = json.loads(_share_file(f"{type_name}.json").read_text())
    referenced = description["type_description_msg"]["referenced_type_descriptions"]
    blocks = [_share_file(f"{type_name}.msg").read_text()]
    for dependency in sorted(entry["type_name"] for entry in referenced):
        text = _share_file(f"{dependency}.msg").read_text()
        blocks.append(f"{SEPARATOR}\nMSG: {dependency.replace('/msg/', '/')}\n{text}")
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return MessageDefinition(type_name, "\n".join(blocks), hashes[type_name])


def _share_file(relative: str) -> Path:
    """Path of a file below ``share``: of a sourced workspace, else of the Python environment itself."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        path = Path(prefix) / "share" / relative
        if path.is_file():
            return path
    raise RecordingError(
        f"no share/{relative} below {', '.join(prefixes)}; is the interface package {relative.split('/')[0]} installed?"
    )
