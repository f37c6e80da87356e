"""The package file names what the sources import."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
OPTIONAL = {"moveit_msgs"}
"""Packages whose conversions say so where they are missing."""


def test_every_message_package_is_a_dependency() -> None:
    """A workspace that installs the dependencies can import every module."""
    found = re.compile(r"^\s*(?:from|import) (\w+_(?:msgs|srvs|interfaces))\b", re.MULTILINE)
    imported = {name for path in ROOT.glob("defgrasp_ros/**/*.py") for name in found.findall(path.read_text())}
    listed = {element.text for element in ElementTree.parse(ROOT / "package.xml").getroot().iter("depend")}
    assert "sensor_msgs" in imported and imported - listed == OPTIONAL
