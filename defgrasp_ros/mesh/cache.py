"""Keeps tetrahedra on disk, by the content of what they were made from."""

from __future__ import annotations

import hashlib
import os
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

FORMAT = 1
"""Grows when tetrahedra made from the same surface change."""


def cache_directory() -> Path:
    """Return the folder of the cached meshes: ``defgrasp/meshes`` below ``$XDG_CACHE_HOME``, or ``~/.cache``."""
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "defgrasp" / "meshes"


def key_of(*contents: np.ndarray | float) -> str:
    """Return the name under which the tetrahedra of these arrays and numbers are kept."""
    try:
        mesher = version("pytetwild")
    except PackageNotFoundError:
        mesher = ""
    digest = hashlib.sha256(f"{FORMAT} {mesher}".encode())
    for content in contents:
        array = np.ascontiguousarray(content)
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def load(key: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Return vertices and tetrahedra kept under a name; None if there are none that can be read."""
    try:
        with np.load(cache_directory() / f"{key}.npz") as arrays:
            return arrays["vertices"], arrays["tetrahedra"]
    except Exception:  # a file cut short fails in many ways, and is as good as none
        return None


def store(key: str, vertices: np.ndarray, tetrahedra: np.ndarray) -> None:
    """Keep tetrahedra; where the folder cannot be written they are made again next time."""
    directory = cache_directory()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=directory, suffix=".tmp", delete=False) as file:
            np.savez(file, vertices=vertices, tetrahedra=tetrahedra)
        os.replace(file.name, directory / f"{key}.npz")
    except OSError:
        return
