"""How a run was made: what a reader of its log needs to make it again."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import yaml

from defgrasp_ros.configuration import PACKAGE_NAME

PACKAGES = (PACKAGE_NAME, "warp-lang", "numpy")


def provenance(device: str, parameters: Mapping[str, object]) -> dict[str, str]:
    """Return versions, device and parameters as text.

    Args:
        device: Where the simulation runs, e.g. ``cuda:0``.
        parameters: Names and values, kept as YAML.
    """
    versions = {f"version.{name}": _version(name) for name in PACKAGES}
    return {**versions, "device": device, "parameters": yaml.safe_dump(dict(parameters), sort_keys=False)}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # a source tree that is not installed
        return "unknown"
