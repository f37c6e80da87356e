"""Fixtures shared by the tests."""

import os
import signal
from importlib.metadata import version
from pathlib import Path

import pytest


def pytest_configure() -> None:
    """Undo that a shell starts background jobs deaf to Ctrl-C: the processes that tests interrupt would inherit it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_directory() -> Path:
    """Folder with reference objects beside the repository; tests that need it are skipped without it."""
    path = Path(__file__).resolve().parents[2] / "shared"
    if not path.is_dir():
        pytest.skip("reference data beside the repository is not there")
    return path


def kernel_cache() -> Path:
    """Folder in which Warp keeps compiled kernels unless told otherwise; one per version."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return caches / "warp" / version("warp-lang")


@pytest.fixture(scope="session", autouse=True)
def mesh_cache(tmp_path_factory):
    """Meshes are cached in a folder of this run, so that every run makes them itself."""
    os.environ.setdefault("WARP_CACHE_PATH", str(kernel_cache()))  # compiled kernels depend on nothing in the tests
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["XDG_CACHE_HOME"]
    else:
        os.environ["XDG_CACHE_HOME"] = before
