"""``defgrasp objects``: the objects and materials that come with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table


def objects(
    materials: Annotated[bool, typer.Option("--materials", help="List the materials instead")] = False,
    picture: Annotated[Path | None, typer.Option(help="Contact sheet of all objects to write (.png)")] = None,
) -> None:
    """List the objects that need no mesh file, or the materials, with their sources."""
    if materials:
        Console().print(_material_table())
        return
    from defgrasp_ros.objects import object_library

    library = list(object_library().values())
    if picture is not None:
        from defgrasp_ros.drawing.object_sheet import draw_objects

        draw_objects(picture, library)
        Console(stderr=True).print(f"wrote {picture}", soft_wrap=True)
        return
    table = Table(header_style="bold", pad_edge=False)
    for title in ("object", "category", "shape", "dimensions", "material"):
        table.add_column(title, no_wrap=title == "object")
    for entry in library:
        dimensions = ", ".join(f"{key} {_dimension(key, value)}" for key, value in entry.dimensions.items())
        table.add_row(entry.name, entry.category, entry.shape, dimensions, entry.material.name)
    Console().print(table)


PURE_NUMBERS = ("flat_base", "flatness", "sides", "bend", "angle")
"""Dimensions that are no lengths."""


def _dimension(key: str, value: float | list[float]) -> str:
    if key in PURE_NUMBERS:
        return f"{value:g}"
    lengths = value if isinstance(value, list) else [value]
    return " x ".join(f"{1e3 * length:g}" for length in lengths) + " mm"


def _material_table() -> Table:
    from defgrasp_ros.material_library import material_library

    table = Table(header_style="bold", pad_edge=False)
    for title in ("material", "E\nPa", "nu", "density\nkg/m^3", "mu", "limit\nPa", "basis", "source"):
        table.add_column(title, no_wrap=title == "material")
    for record in material_library().values():
        substance = record.material
        limit = "-"
        if record.yield_stress:
            limit = f"yields {record.yield_stress:.2g}"
        elif record.breaking_stress:
            limit = f"breaks {record.breaking_stress:.2g}"
        numbers = (
            substance.youngs_modulus,
            substance.poissons_ratio,
            substance.density,
            substance.friction_coefficient,
        )
        table.add_row(record.name, *(f"{number:g}" for number in numbers), limit, record.basis, record.source)
    return table
