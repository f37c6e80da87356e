"""``defgrasp info``: what is in a log."""

from __future__ import annotations

import json
import sys
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from defgrasp_ros.commands.log_argument import LogArgument

if TYPE_CHECKING:
    from defgrasp_ros.recording.log_summary import LogSummary

LONG_FACTS = ("parameters", "gripper", "options")
"""Facts of a run that are documents of their own; --json has them."""


def info(
    log: LogArgument,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on standard output, and nothing else")
    ] = False,
) -> None:
    """Show what is in LOG: how the run was made, topics, files inside, and the outcome of each grasp.

    A log whose writer died is read up to where it ends.
    """
    from defgrasp_ros.recording.log_summary import summarize_log

    summary = summarize_log(log)
    if as_json:
        json.dump(summary.document(), sys.stdout, allow_nan=False)
        sys.stdout.write("\n")
        return
    console = Console(width=None if sys.stdout.isatty() else 200)
    console.print(_fact_table(summary), _topic_table(summary), sep="\n")
    if summary.grasp_count or summary.outcomes:
        console.print(_outcome_table(summary))


def _fact_table(summary: LogSummary) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    state = "complete" if summary.complete else "ends early: its writer died or the disk was full"
    from defgrasp_ros.recording.topic import NANOSECONDS

    start = datetime.fromtimestamp(summary.start_time / NANOSECONDS).astimezone() if summary.start_time else None
    waited = summary.statistics.get("waiting_time")
    facts = {
        "file": str(summary.path),
        "state": state,
        "size": f"{1e-6 * summary.size:.3f} MB",
        "start": start.isoformat(sep=" ", timespec="milliseconds") if start else "-",
        "duration": f"{summary.duration:.3f} s",
        "messages": str(summary.counts.total()),
        "object": summary.object_name or "-",
        "grasps": str(summary.grasp_count),
        **{name: value for name, value in summary.provenance.items() if name not in LONG_FACTS},
        "files inside": ", ".join(f"{name} ({1e-3 * size:.1f} kB)" for name, size in summary.attachments.items()),
        "waited for the disk": f"{waited} s" if waited else "",
    }
    for name, value in facts.items():
        if value:
            table.add_row(name, escape(value))
    return table


def _topic_table(summary: LogSummary) -> Table:
    table = Table(box=SIMPLE_HEAD, header_style="bold", pad_edge=False)
    for title in ("topic", "type", "messages", "quality of service"):
        table.add_column(title, justify="right" if title == "messages" else "left")
    for topic in summary.topics:
        qos = topic.qos
        words = [qos.get("reliability"), qos.get("durability"), f"depth {qos['depth']}" if "depth" in qos else None]
        text = ", ".join(word.replace("_", " ") for word in words if word)
        table.add_row(topic.name, topic.type_name, str(summary.counts[topic.name]), text or "-")
    return table


def _outcome_table(summary: LogSummary) -> Table:
    table = Table(box=SIMPLE_HEAD, header_style="bold", pad_edge=False)
    for title in ("grasp", "id", "outcome", "why"):
        table.add_column(title, justify="right" if title == "grasp" else "left")
    known = {outcome.grasp_index: outcome for outcome in summary.outcomes}
    for index in sorted({*range(summary.grasp_count), *known}):
        if outcome := known.get(index):
            table.add_row(str(index), escape(outcome.grasp_id), outcome.code.name, escape(outcome.message))
        else:
            table.add_row(str(index), "", "-", "not in the log")
    return table
