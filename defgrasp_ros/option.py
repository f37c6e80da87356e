"""Options: fields of a data class that carry their meaning, unit and range.

The check of the value, the command line and the parameters of the node all come from these fields.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from defgrasp_ros.checks import interval, require_in_range
from defgrasp_ros.errors import DefgraspError


@dataclass(frozen=True)
class Option:
    """What an option means and which values it takes.

    Args:
        default: Value where none is given; its type is the option's.
        meaning: In a phrase.
        unit: Of a number, ``"-"`` for a ratio or a count.
        low: Smallest value.
        high: Largest value.
        low_open: Whether ``low`` itself is refused.
    """

    default: Any
    meaning: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False

    @property
    def text(self) -> str:
        """Meaning, of a number with unit and range, e.g. ``"Time step [s], in [1e-05, 0.02]"``."""
        if self.kind is bool:
            return self.meaning
        return f"{self.meaning} [{self.unit}], in {interval(self.low, self.high, self.low_open)}"

    @property
    def default_text(self) -> str:
        """The default as people write it."""
        return str(self.default).lower() if self.kind is bool else f"{self.default:g}"

    @property
    def kind(self) -> type:
        """Type of its values."""
        return type(self.default)

    def checked(self, error: type[DefgraspError], name: str, value: Any) -> Any:
        """Return a value as one of the option's type.

        Raises:
            DefgraspError: Of class ``error``, naming the option, the value and what is allowed.
        """
        if self.kind is bool:
            if not isinstance(value, bool):
                raise error(f"{name} = {value!r} is neither true nor false")
            return value
        unit = "" if self.unit == "-" else self.unit
        number = require_in_range(error, name, value, self.low, self.high, low_open=self.low_open, unit=unit)
        if self.kind is int and not number.is_integer():
            raise error(f"{name} = {number:g} is not a whole number")
        return self.kind(number)


def option(default: Any, meaning: str, unit: str = "", low: float = -math.inf, high: float = math.inf, **more) -> Any:
    """Return a field of a data class that is an option; arguments as for ``Option``."""
    return dataclasses.field(default=default, metadata={"option": Option(default, meaning, unit, low, high, **more)})


def options_of(data_class: type) -> dict[str, Option]:
    """Return the options of a data class by name, in their order."""
    fields = dataclasses.fields(data_class)
    return {field.name: field.metadata["option"] for field in fields if "option" in field.metadata}
