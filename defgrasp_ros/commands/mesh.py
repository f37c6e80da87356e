"""``defgrasp mesh``: what an object is like, and its tetrahedra."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from defgrasp_ros.commands.object_argument import (
    EdgeLength,
    EdgeRadius,
    ElementOrder,
    ObjectArgument,
    Scale,
    WallThickness,
    prepared_object,
)
from defgrasp_ros.material import Material
from defgrasp_ros.material_library import find_material


def mesh(
    object: ObjectArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Tetrahedra to write: .tet, .mesh, .msh, .vtk or .vtu")
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Print the report as one JSON document on standard output")
    ] = False,
    material: Annotated[
        str | None,
        typer.Option(help="Material of the library, for the mass; default: the object's own, or 1000 kg/m^3"),
    ] = None,
    scale: Scale = 1.0,
    edge_length: EdgeLength = None,
    wall_thickness: WallThickness = None,
    edge_radius: EdgeRadius = None,
    element_order: ElementOrder = None,
) -> None:
    """Read OBJECT, mend and mesh it, and report size, mass, quality and what may be wrong.

    Files of type .tet and .mesh cannot say that tetrahedra have ten nodes: what is made for them has four by default.
    """
    from defgrasp_ros.mesh.mesh_files import TEXT_FORMATS
    from defgrasp_ros.mesh.mesh_writer import write_mesh
    from defgrasp_ros.mesh.report import mesh_report

    has_corners_alone = output is not None and output.suffix.lower().removeprefix(".") in TEXT_FORMATS
    if element_order is None and has_corners_alone:
        element_order = 1
    name, prepared, default = prepared_object(object, scale, edge_length, wall_thickness, edge_radius, element_order)
    substance: Material = find_material(material).material if material else default
    result = mesh_report(name, prepared, substance)
    if output is not None:
        write_mesh(output, prepared.mesh)
        Console(stderr=True).print(f"wrote {output}", soft_wrap=True)
    if report:
        json.dump(result.document(), sys.stdout, allow_nan=False)
        sys.stdout.write("\n")
        return
    Console().print("\n".join(result.lines()), markup=False, highlight=False, soft_wrap=True)
