"""``defgrasp export``: the log of a run as HDF5 or as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from defgrasp_ros.commands.log_argument import LogArgument
from defgrasp_ros.errors import InvalidOptionsError


def export(
    log: LogArgument,
    hdf5: Annotated[
        Path | None, typer.Option(help="HDF5 file to write, with the datasets of DefGraspSim and our own")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="Folder for tables of grasps, directions and time series (.csv)")
    ] = None,
) -> None:
    """Write the results of LOG for other programs: as HDF5, as tables, or both. A log that was cut off will do."""
    from defgrasp_ros.analysis import load_run

    if hdf5 is None and csv is None:
        raise InvalidOptionsError("nothing to write; give --hdf5 FILE, --csv FOLDER, or both")
    console = Console(stderr=True)
    run = load_run(log)
    if hdf5 is not None:
        from defgrasp_ros.analysis.hdf5_export import write_hdf5

        write_hdf5(hdf5, run)
        console.print(f"wrote {hdf5}", soft_wrap=True)
    if csv is not None:
        from defgrasp_ros.analysis.tables import write_tables

        for path in write_tables(csv, run):
            console.print(f"wrote {path}", soft_wrap=True)
    for note in run.notes:
        console.print(note, markup=False, highlight=False, soft_wrap=True)
