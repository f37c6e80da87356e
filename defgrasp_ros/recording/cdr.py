"""Exact CDR encoding of ROS messages (XCDR version 1, little endian).

The middleware's own serialisation may leave padding bytes undefined and append more behind the message, which
strict readers refuse and which makes equal runs give different files. Here padding is zero and nothing follows.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractSequence,
    AbstractString,
    AbstractType,
    BasicType,
    NamespacedType,
)

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Header of little-endian plain CDR; alignment counts from behind it."""

BASIC_TYPES = {
    "boolean": ("?", "?"),
    "octet": ("c", "S1"),
    "int8": ("b", "i1"),
    "uint8": ("B", "u1"),
    "int16": ("h", "<i2"),
    "uint16": ("H", "<u2"),
    "int32": ("i", "<i4"),
    "uint32": ("I", "<u4"),
    "int64": ("q", "<i8"),
    "uint64": ("Q", "<u8"),
    "float": ("f", "<f4"),
    "double": ("d", "<f8"),
}
"""Codes of each basic type for ``struct`` (one value) and for NumPy (arrays)."""

FieldWriter = Callable[[bytearray, Any], None]
"""Appends one value to a message under construction."""


def encode_cdr(message: object) -> bytes:
    """Return a ROS message as CDR, header included.

    Raises:
        NotImplementedError: If the message has a field of a type without an encoding here (wide strings).
    """
    data = bytearray()
    _message_writer(type(message))(data, message)
    return ENCAPSULATION + bytes(data)


@cache
def _message_writer(message_class: type) -> FieldWriter:
    names = message_class.get_fields_and_field_types()
    fields = [(name, _field_writer(kind)) for name, kind in zip(names, message_class.SLOT_TYPES, strict=True)]
    if not fields:
        return lambda data, _: data.append(0)  # IDL has no empty structures; an invisible byte stands for them

    def write(data: bytearray, message: object) -> None:
        for name, write_field in fields:
            write_field(data, getattr(message, name))

    return write


def _field_writer(kind: AbstractType) -> FieldWriter:
    if isinstance(kind, BasicType):
        return _basic_writer(kind)
    if isinstance(kind, AbstractString):
        return _write_string
    if isinstance(kind, NamespacedType):
        return _message_writer(getattr(import_module(".".join(kind.namespaces)), kind.name))
    if isinstance(kind, AbstractNestedType):
        return _collection_writer(kind)
    raise NotImplementedError(f"no CDR encoding for {type(kind).__name__}")


def _basic_writer(kind: BasicType) -> FieldWriter:
    layout = struct.Struct(f"<{BASIC_TYPES[kind.typename][0]}")

    def write(data: bytearray, value: object) -> None:
        _align(data, layout.size)
        data.extend(layout.pack(value))

    return write


def _collection_writer(kind: AbstractNestedType) -> FieldWriter:
    """Arrays are their elements; sequences have their length before them."""
    has_length = isinstance(kind, AbstractSequence)
    write_elements = _elements_writer(kind.value_type)

    def write(data: bytearray, values: Any) -> None:
        if has_length:
            _write_length(data, len(values))
        write_elements(data, values)

    return write


def _elements_writer(kind: AbstractType) -> FieldWriter:
    if isinstance(kind, BasicType):
        element = np.dtype(BASIC_TYPES[kind.typename][1])

        def write(data: bytearray, values: Any) -> None:
            if len(values):
                _align(data, element.itemsize)
                data.extend(np.asarray(values, dtype=element).tobytes())

        return write

    write_element = _field_writer(kind)

    def write_each(data: bytearray, values: Any) -> None:
        for value in values:
            write_element(data, value)

    return write_each


def _write_string(data: bytearray, value: str) -> None:
    content = value.encode() + b"\0"
    _write_length(data, len(content))
    data.extend(content)


def _write_length(data: bytearray, length: int) -> None:
    _align(data, 4)
    data.extend(length.to_bytes(4, "little"))


def _align(data: bytearray, size: int) -> None:
    data.extend(bytes(-len(data) % size))
