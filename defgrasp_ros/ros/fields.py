"""Copies values between dataclasses, arrays and message fields of the same names."""

from __future__ import annotations

import array
import dataclasses
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3

from defgrasp_ros.recording.topic import NANOSECONDS

Record = TypeVar("Record")


def fill(message: Any, record: Any) -> Any:
    """Set each field of ``message`` to the attribute of that name of the dataclass instance ``record``; return it."""
    for name in (field.name for field in dataclasses.fields(record)):
        kind = type(getattr(message, name))
        setattr(message, name, kind(getattr(record, name)))
    return message


def extract(record_class: type[Record], message: Any) -> Record:
    """Return a dataclass instance from the fields of ``message`` of the same names."""
    return record_class(**{field.name: getattr(message, field.name) for field in dataclasses.fields(record_class)})


def flat(values: np.ndarray, typecode: str = "d") -> array.array:
    """Return an array in row-major order as a message field takes it fastest."""
    return array.array(typecode, np.ascontiguousarray(values, dtype=np.dtype(typecode)).tobytes())


def rows(values: array.array, width: int) -> np.ndarray:
    """Return a flat message field as an array of shape ``(row, width)``."""
    return np.asarray(values).reshape(-1, width)


def vector_message(vector: np.ndarray) -> Vector3:
    """Return ``(3,)`` numbers as a vector message."""
    x, y, z = map(float, vector)
    return Vector3(x=x, y=y, z=z)


def vector_from_message(message: Vector3) -> np.ndarray:
    """Return a vector message as ``(3,)`` numbers."""
    return np.array([message.x, message.y, message.z])


def point_message(point: np.ndarray) -> Point:
    """Return ``(3,)`` numbers as a point message."""
    x, y, z = map(float, point)
    return Point(x=x, y=y, z=z)


def time_message(nanoseconds: int) -> Time:
    """Return nanoseconds since the epoch as a time message."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)
