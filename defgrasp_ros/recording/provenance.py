"""How a run was made: what a reader of its log needs to make it again."""

from __future__ import annotations

import dataclasses
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml

from defgrasp_ros.configuration import PACKAGE_NAME
from defgrasp_ros.evaluation import EvaluationOptions, in_order
from defgrasp_ros.gripper import Gripper

PACKAGES = (PACKAGE_NAME, "warp-lang", "numpy", "scipy", "mcap")

GIT_TIME_LIMIT = 5.0
"""How long the version control may take to answer [s]."""


def provenance(
    device: str,
    parameters: Mapping[str, object],
    gripper: Gripper,
    options: EvaluationOptions,
    element_order: int = 1,
) -> dict[str, str]:
    """Return versions, device, parameters, gripper and options as text.

    Args:
        device: Where the simulation runs, e.g. ``cuda:0``.
        parameters: Names and values, kept as YAML.
        gripper: What was used; its values are kept as YAML.
        options: What is done with each grasp, request, preset and parameters taken together; kept as YAML.
        element_order: Of the object's mesh, whose file has the corners of the elements alone.
    """
    experiments = [str(experiment) for experiment in in_order(options.experiments)]
    versions = {f"version.{name}": _version(name) for name in PACKAGES}
    return {
        **versions,
        "version.python": platform.python_version(),
        "git_revision": git_revision(),
        "device": device,
        "seed": "none: nothing in a run is drawn by chance",
        "element_order": str(element_order),
        "parameters": yaml.safe_dump(dict(parameters), sort_keys=False),
        "gripper": yaml.safe_dump(dataclasses.asdict(gripper), sort_keys=False),
        "options": yaml.safe_dump({**dataclasses.asdict(options), "experiments": experiments}, sort_keys=False),
    }


@cache
def git_revision() -> str:
    """Return the revision of the sources, ``-dirty`` appended where they were changed since; empty if not in git."""
    package = Path(__file__).resolve().parents[1]
    if _git(package, "rev-parse", "--show-toplevel") != str(package.parent):  # an installed package in some repository
        return ""
    return _git(package, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")


def _git(directory: Path, *arguments: str) -> str:
    command = ["git", "-C", str(directory), *arguments]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIME_LIMIT)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip() if answer.returncode == 0 else ""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # a source tree that is not installed
        return "unknown"
