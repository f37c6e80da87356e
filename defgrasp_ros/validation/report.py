"""Cases as a table for people and as a JSON document."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from defgrasp_ros.validation.case import Case


def case_table(cases: list[Case]) -> Table:
    """Return a table with one row per case."""
    table = Table(header_style="bold", pad_edge=False, box=SIMPLE_HEAD)
    table.add_column("case", ratio=3)
    for title in ("measured", "reference", "error", "tolerance"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("source", ratio=4)
    for case in cases:
        style = "green" if case.passed else "bold red"
        numbers = _cell(case.measured, ".6g"), _cell(case.reference, ".6g")
        error, tolerance = _cell(case.error, ".2g"), _cell(case.tolerance, ".2g")
        table.add_row(Text(case.name), *numbers, Text(error, style=style), tolerance, Text(case.source))
    return table


def case_document(cases: list[Case]) -> dict[str, Any]:
    """Return the cases as plain JSON types; null for what was not measured."""
    return {"cases": [{key: _plain(value) for key, value in dataclasses.asdict(case).items()} for case in cases]}


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cell(value: float, style: str) -> str:
    return format(value, style) if math.isfinite(value) else "-"
