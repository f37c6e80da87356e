"""Shows how far something is."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from defgrasp_ros import evaluation as ev


def progress_line(console: Console) -> Progress:
    """A line that shows how far something is, and vanishes at the end."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True)


class ProgressBar(ev.EvaluationObserver):
    """Shows how far a run is."""

    sample_interval = float("inf")

    def __init__(self, console: Console, grasp_count: int):
        self._progress = progress_line(console)
        self._task = self._progress.add_task(f"{grasp_count} grasps", total=1.0)
        self._grasp_count = grasp_count

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def on_progress(self, progress: ev.Progress) -> None:
        phase = progress.phase.name.lower().replace("_", " ")
        text = f"{phase}, {progress.active_grasps} of {self._grasp_count} grasps running"
        self._progress.update(self._task, completed=progress.fraction, description=text)
