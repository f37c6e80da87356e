"""Unit and meaning of every number, from the comments of the message definitions.

The definitions are the one place where they are written down; tables, files and pages quote them.
"""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

from defgrasp_ros.recording.definitions import SEPARATOR, message_definition

FIELD = re.compile(r"^[\w/]+(?:\[[^\]]*\])?\s+(?P<name>\w+)(?:\s+[^#=]+?)?\s*#\s*(?P<comment>.*)$")
CONTINUATION = re.compile(r"^\s+#\s*(?P<comment>.*)$")
UNIT = re.compile(r"^\[(?P<unit>[^\]]*)\]\s*(?P<rest>.*)$")


class FieldNote(NamedTuple):
    """What a message definition says about a field."""

    unit: str
    """E.g. ``Pa``; ``-`` for a pure number, empty where the field is none."""
    meaning: str


@cache
def field_notes(type_name: str) -> dict[str, FieldNote]:
    """Return the notes on all fields of a message, e.g. of ``defgrasp_interfaces/msg/GraspMetrics``, by field.

    Raises:
        RecordingError: If the interface package is not installed.
    """
    comments: dict[str, str] = {}
    name = None
    for line in message_definition(type_name).text.split(SEPARATOR)[0].splitlines():
        if field := FIELD.match(line):
            name = field["name"]
            comments[name] = field["comment"]
        elif name and (more := CONTINUATION.match(line)):
            comments[name] += " " + more["comment"]
        else:
            name = None
    return {name: _note(comment) for name, comment in comments.items()}


def _note(comment: str) -> FieldNote:
    unit = UNIT.match(comment.strip())
    return FieldNote(unit["unit"], unit["rest"].strip()) if unit else FieldNote("", comment.strip())
