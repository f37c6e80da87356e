"""``defgrasp report``: the log of a run as a page for people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from defgrasp_ros.commands.log_argument import LogArgument


def report(
    log: LogArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="Page to write (.html)")] = Path("report.html"),
    grasps: Annotated[
        str | None,
        typer.Option(
            help="Grasps to show in detail: numbers or ids as 0,3,7, or all; default: all of up to six, else the best, "
            "the worst and some that failed"
        ),
    ] = None,
) -> None:
    """Write one self-contained page about the run in LOG: tables, pictures, charts. A log that was cut off will do."""
    from defgrasp_ros.analysis import load_run
    from defgrasp_ros.analysis.report_page import write_report

    run = load_run(log)
    write_report(output, run, grasps)
    Console(stderr=True).print(f"wrote {output}", soft_wrap=True)
