"""``defgrasp sample``: candidate grasps for an object."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from defgrasp_ros.commands.object_argument import ObjectArgument, Scale, WallThickness, object_surface, prepared_object
from defgrasp_ros.errors import EmptyGraspListError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import DEFAULT_GRIPPER, Gripper, load_gripper


def sample(
    object: ObjectArgument,
    count: Annotated[int, typer.Option("-n", "--count", help="How many grasps")] = 50,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Grasp file to write: .json, or .h5 as of DefGraspSim")
    ] = None,
    gripper: Annotated[str, typer.Option(help="Gripper description in config/grippers")] = DEFAULT_GRIPPER,
    sampler: Annotated[str, typer.Option(help="antipodal, surface, uniform, grid or polar")] = "antipodal",
    max_angle: Annotated[
        float | None, typer.Option(help="antipodal: largest angle of contact normals and closing axis [rad]")
    ] = None,
    standoff: Annotated[
        float, typer.Option(help="antipodal: how far the tool centre stays behind the contacts [m]")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Equal seeds give equal grasps")] = 0,
    check: Annotated[
        Path | None, typer.Option(help="Do not sample: keep those grasps of this file at which the gripper fits")
    ] = None,
    scale: Scale = 1.0,
    wall_thickness: WallThickness = None,
    picture: Annotated[Path | None, typer.Option(help="Picture of the grasps to write (.png)")] = None,
) -> None:
    """Find grasps for OBJECT at which the open gripper is free and has the object between its pads."""
    from defgrasp_ros.grasp_files import write_grasps
    from defgrasp_ros.sampling import sample_grasps
    from defgrasp_ros.sampling.antipodal import DEFAULT_CONE
    from defgrasp_ros.sampling.detail import with_fewer_triangles

    console = Console(stderr=True)
    hand = load_gripper(gripper)
    if wall_thickness is None:
        name, vertices, triangles = object_surface(object, scale)
    else:
        name, prepared, _ = prepared_object(object, scale, wall_thickness=wall_thickness)
        vertices, triangles = prepared.mesh.vertices, prepared.mesh.surface_triangles
    vertices, triangles = with_fewer_triangles(vertices, triangles)
    if check is not None:
        grasps = _fitting_grasps(check, vertices, triangles, hand, console)
    else:
        grasps = sample_grasps(
            vertices,
            triangles,
            hand,
            count,
            sampler=sampler,
            max_angle=DEFAULT_CONE if max_angle is None else max_angle,
            standoff=standoff,
            seed=seed,
        )
        if len(grasps) < count:
            console.print(f"only {len(grasps)} of {count} grasps were found")
    if output is not None:
        write_grasps(output, grasps)
        console.print(f"wrote {len(grasps)} grasps to {output}", soft_wrap=True)
    if picture is not None:
        from defgrasp_ros.drawing.sampled_grasps import draw_grasps

        draw_grasps(picture, name, vertices, triangles, hand, grasps)
        console.print(f"wrote {picture}", soft_wrap=True)
    if output is None and picture is None:
        _print_grasps(grasps)


def _fitting_grasps(
    path: Path, vertices: np.ndarray, triangles: np.ndarray, hand: Gripper, console: Console
) -> list[Grasp]:
    from defgrasp_ros.grasp_files import read_grasps
    from defgrasp_ros.sampling import Fit, HandFit

    fit = HandFit(vertices, triangles, hand)
    kept = []
    for grasp in read_grasps(path):
        state = fit.check(grasp.position, grasp.rotation)
        if state is Fit.FREE:
            kept.append(grasp)
        else:
            console.print(f"left out {grasp.id}: {state.value}", markup=False, highlight=False)
    if not kept:
        raise EmptyGraspListError(f"{path}: the gripper fits at none of the grasps")
    return kept


def _print_grasps(grasps: list[Grasp]) -> None:
    from rich.table import Table

    table = Table(header_style="bold", pad_edge=False)
    for title in ("grasp", "x\nmm", "y\nmm", "z\nmm", "approach\nx y z", "closing axis to\nvertical, deg"):
        table.add_column(title, justify="left" if title == "grasp" else "right")
    for grasp in grasps:
        approach, closing = grasp.rotation[:, 2], grasp.rotation[:, 1]
        tilt = math.degrees(math.acos(min(1.0, abs(closing[2]))))
        numbers = [f"{1e3 * value:.1f}" for value in grasp.position]
        table.add_row(grasp.id, *numbers, " ".join(f"{value:+.2f}" for value in approach), f"{tilt:.0f}")
    Console().print(table)
