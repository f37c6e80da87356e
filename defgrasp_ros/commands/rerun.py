"""``defgrasp rerun``: repeats a logged run, and compares."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from defgrasp_ros.commands.log_argument import LogArgument
from defgrasp_ros.commands.progress import ProgressBar

if TYPE_CHECKING:
    from defgrasp_ros.comparison import GraspComparison


def rerun(
    log: LogArgument,
    device: Annotated[str | None, typer.Option(help="cpu or cuda:0; default: that of the log")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on standard output, and nothing else")
    ] = False,
) -> None:
    """Repeat the run of LOG with the mesh, gripper, options and grasps in it, and report what differs.

    Exit status 1 if a grasp has another outcome. Grasps that the log has no result for, or that were canceled there,
    are evaluated, but not compared.
    """
    from defgrasp_ros.comparison import compare
    from defgrasp_ros.experiments import evaluate_grasps
    from defgrasp_ros.recording import provenance
    from defgrasp_ros.ros.logged_run import read_run, record_of

    console = Console(stderr=True)
    run = read_run(log)
    device = device or run.device
    now = provenance(device, {}, run.gripper, run.options)
    for name, value in run.provenance.items():
        if name in now and name.startswith(("version.", "git_", "device")) and value != now[name]:
            console.print(f"{name}: recorded {value or '-'}, now {now[name] or '-'}", highlight=False, soft_wrap=True)
    repeated = {each.grasp_index: record_of(each) for each in run.grasps.refused}
    indices, grasps = list(run.grasps.valid), list(run.grasps.valid.values())
    with ProgressBar(console, len(grasps)) as bar:
        evaluations = evaluate_grasps(run.object_model, grasps, run.gripper, run.options, device, bar)
    for index, evaluation in zip(indices, evaluations, strict=True):
        repeated[index] = record_of(replace(evaluation, grasp_index=index))
    comparisons = compare(run.recorded, repeated)
    different = [each for each in comparisons if not each.same_outcome]
    if as_json:
        document = {
            "log": str(log),
            "device": device,
            "same_outcomes": not different,
            "grasps": [each.document() for each in comparisons],
        }
        json.dump(document, sys.stdout, allow_nan=False)
        sys.stdout.write("\n")
    else:
        screen = Console(width=None if sys.stdout.isatty() else 200)
        screen.print(_table(comparisons))
        screen.print(f"{len(comparisons)} grasps, {len(different)} with another outcome")
    if different:
        raise typer.Exit(1)


def _table(comparisons: list[GraspComparison]) -> Table:
    table = Table(box=SIMPLE_HEAD, header_style="bold", pad_edge=False)
    for title in ("grasp", "id", "recorded", "repeated", "largest relative\ndifference", "of"):
        table.add_column(title, justify="right" if title in ("grasp", "largest relative\ndifference") else "left")
    for each in comparisons:
        recorded = each.first_code.name if each.first_code is not None else "-"
        largest = each.largest
        size, name = (f"{largest.relative:.2e}", largest.name) if largest else ("-", "")
        if largest and largest.relative == 0.0:
            size, name = "0", ""
        table.add_row(str(each.grasp_index), escape(each.grasp_id), recorded, each.second_code.name, size, name)
    return table
