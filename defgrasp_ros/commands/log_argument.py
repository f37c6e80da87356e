"""The argument of the commands that read a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LogArgument = Annotated[
    Path, typer.Argument(metavar="LOG", help="Bag folder of a run, or the .mcap file in it", show_default=False)
]
