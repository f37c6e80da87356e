"""Evaluate grasps of deformable objects by finite element simulation."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("defgrasp_ros")
except PackageNotFoundError:  # run from the sources, not installed
    __version__ = "unknown"
