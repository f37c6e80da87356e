"""Where the files of ``config/`` are: beside the sources, or in the share folder of an installed package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PACKAGE_NAME = "defgrasp_ros"


def config_file(relative: str) -> Path:
    """Return the path of a file of ``config/``; of the first place to look if none has it."""
    source = Path(__file__).resolve().parents[1] / "config" / relative
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    shares = [Path(prefix) / "share" / PACKAGE_NAME / "config" / relative for prefix in prefixes]
    return next((path for path in (source, *shares) if path.is_file()), source)
