"""``defgrasp grippers``: the grippers that come with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from defgrasp_ros.gripper import gripper_names, load_gripper


def grippers(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Gripper whose URDF is printed")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File for the URDF")] = None,
) -> None:
    """List the grippers, or write one as URDF."""
    if name is not None:
        from defgrasp_ros.gripper_urdf import gripper_urdf

        document = gripper_urdf(load_gripper(name))
        if output is None:
            print(document, end="")
        else:
            output.write_text(document)
        return
    table = Table(header_style="bold", pad_edge=False)
    titles = ("gripper", "opens to\nmm", "flat pad\nmm", "fillets side, tip\nmm", "largest force\nN, sum of pads")
    for title in titles:
        table.add_column(title, justify="left" if title == "gripper" else "right")
    for hand in map(load_gripper, gripper_names()):
        flat = f"{2e3 * hand.pad_half_width:.3g} x {1e3 * (hand.pad_top - hand.pad_bottom):.3g}"
        fillets = f"{1e3 * hand.side_fillet:g}, {1e3 * hand.tip_fillet:g}"
        table.add_row(hand.name, f"{2e3 * hand.max_opening:.4g}", flat, fillets, f"{hand.max_force:g}")
    Console().print(table)
