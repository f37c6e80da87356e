#!/usr/bin/env python3
"""Generate, compile and install the ROS interfaces of msg_defs/ into the environment of this interpreter.

For environments where ROS comes from Python wheels; with a full ROS installation colcon does it. Run it with the
environment's own Python. Afterwards ``import defgrasp_interfaces`` works in that environment without sourcing
anything. Nothing is done when the definitions and all they are compiled against are as they were the last time.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import distributions
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
DEFINITIONS = REPOSITORY / "msg_defs"
WHEELS_INCLUDE = REPOSITORY / "tools" / "cmake" / "ros_wheels.cmake"

PREFIX = Path(sys.prefix)
SITE_PACKAGES = Path(sysconfig.get_path("purelib"))
BUILD_DIRECTORY = PREFIX / "build" / "defgrasp_interfaces"
LOG = BUILD_DIRECTORY / "build.log"
STAMP = PREFIX / "share" / "defgrasp_interfaces" / "build.sha256"
LOCK = PREFIX / "build" / "defgrasp_interfaces.lock"

LOG_TAIL_LINES = 40
PARALLEL_JOBS = 2
"""Each compiler takes up to 0.5 GB, so small machines are not filled with more."""


class BuildError(Exception):
    """The interfaces could not be built; the text says why and what to do."""


def main() -> int:
    """Build if necessary and return the exit status."""
    try:
        build_if_changed()
    except BuildError as error:
        print(f"build_interfaces: {error}", file=sys.stderr)
        return 1
    return 0


def build_if_changed() -> None:
    """Build unless the installed interfaces were made from the same input.

    Raises:
        BuildError: If a tool is missing or a step of the build fails.
    """
    require_virtual_environment()
    with exclusive_lock():
        wanted = input_hash()
        if STAMP.is_file() and STAMP.read_text() == wanted:
            print("defgrasp_interfaces: up to date")
            return
        require_tools()
        started = time.monotonic()
        print("defgrasp_interfaces: generating and compiling (half a minute to a few minutes) ...", flush=True)
        build_and_install()
        # Last of all: a build that was interrupted has no stamp, or an old one, and is done again.
        STAMP.write_text(wanted)
        print(f"defgrasp_interfaces: installed into {PREFIX} after {time.monotonic() - started:.0f} s")


def input_hash() -> str:
    """Return a digest of everything the result depends on: definitions, recipe, Python, NumPy and ROS packages."""
    digest = hashlib.sha256()
    files = [path for path in DEFINITIONS.rglob("*") if path.is_file()]
    for path in sorted([*files, WHEELS_INCLUDE, Path(__file__).resolve()]):
        digest.update(f"{path.relative_to(REPOSITORY)}\0".encode() + path.read_bytes() + b"\0")
    packages = {f"{package.name}=={package.version}" for package in distributions()}
    relevant = sorted(package for package in packages if package.startswith(("ros-", "numpy==")))
    digest.update("\n".join([str(PREFIX), platform.python_version(), *relevant]).encode())
    return digest.hexdigest()


def require_virtual_environment() -> None:
    """Refuse to install into the system's Python."""
    if sys.prefix == sys.base_prefix:
        raise BuildError(f"{sys.executable} is no virtual environment; run `make setup`, which makes one and calls me")


def require_tools() -> None:
    """Check what PyPI cannot provide, before CMake complains about it less clearly."""
    missing = []
    if not (os.environ.get("CXX") or shutil.which("c++")):
        missing.append("a C++ compiler (Debian, Ubuntu: sudo apt install g++)")
    if not shutil.which("make"):
        missing.append("make (Debian, Ubuntu: sudo apt install make)")
    headers = Path(sysconfig.get_path("include"))
    if not (headers / "Python.h").is_file():
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        missing.append(f"the headers of Python {version} (Debian, Ubuntu: sudo apt install python{version}-dev)")
    if not (PREFIX / "bin" / "cmake").is_file():
        missing.append("the build requirements (pip install -e '.[ros,build]', or `make setup`)")
    if missing:
        raise BuildError("missing: " + "; ".join(missing))


def build_and_install() -> None:
    """Configure and compile with CMake; only when that succeeded, put the result in the place of the last one."""
    shutil.rmtree(BUILD_DIRECTORY, ignore_errors=True)
    BUILD_DIRECTORY.mkdir(parents=True)
    cmake = str(PREFIX / "bin" / "cmake")
    run_step(
        "configure",
        [
            *(cmake, "-S", str(DEFINITIONS), "-B", str(BUILD_DIRECTORY), "-G", "Unix Makefiles"),
            f"-DCMAKE_INSTALL_PREFIX={PREFIX}",
            f"-DCMAKE_PROJECT_INCLUDE={WHEELS_INCLUDE}",
            f"-DPython3_EXECUTABLE={sys.executable}",
            "-DCMAKE_BUILD_TYPE=Release",
            "-DBUILD_TESTING=OFF",
        ],
    )
    run_step("compile", [cmake, "--build", str(BUILD_DIRECTORY), "--parallel", str(PARALLEL_JOBS)])
    remove_installed()
    run_step("install", [cmake, "--install", str(BUILD_DIRECTORY)])


def remove_installed() -> None:
    """Remove all that was installed before, so that nothing of a deleted message stays.

    Libraries are unlinked rather than overwritten: a process that runs with them is not disturbed.
    """
    # First of all, so that a removal or installation which is interrupted is not taken for a complete one.
    STAMP.unlink(missing_ok=True)
    installed = [
        *PREFIX.glob("lib/libdefgrasp_interfaces__*"),
        *PREFIX.glob("include/defgrasp_interfaces"),
        *PREFIX.glob("share/defgrasp_interfaces"),
        *PREFIX.glob("share/ament_index/resource_index/*/defgrasp_interfaces"),
        *SITE_PACKAGES.glob("defgrasp_interfaces*"),
    ]
    for path in installed:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def run_step(name: str, command: list[str]) -> None:
    """Run one command with its output in the log.

    Raises:
        BuildError: If it fails, with the end of the log.
    """
    environment = dict(os.environ, CMAKE_PREFIX_PATH=str(PREFIX), AMENT_PREFIX_PATH=str(PREFIX))
    # A PYTHONPATH or DESTDIR of a sourced ROS or a packaging run would mix other packages in, or install elsewhere.
    for variable in ("PYTHONPATH", "DESTDIR"):
        environment.pop(variable, None)
    with LOG.open("a") as log:
        log.write(f"+ {' '.join(command)}\n")
        log.flush()
        # close_fds: the lock is passed on, see exclusive_lock.
        status = subprocess.run(
            command, stdout=log, stderr=subprocess.STDOUT, env=environment, close_fds=False
        ).returncode
    if status != 0:
        tail = "\n".join(LOG.read_text(errors="replace").splitlines()[-LOG_TAIL_LINES:])
        raise BuildError(f"step '{name}' failed with status {status}; end of {LOG}:\n{tail}")


@contextmanager
def exclusive_lock() -> Iterator[None]:
    """Let one build at a time work on this environment.

    The compilers inherit the lock, so it holds until the last of them has ended, also where this process is killed.
    """
    LOCK.parent.mkdir(parents=True, exist_ok=True)
    with LOCK.open("w") as file:
        os.set_inheritable(file.fileno(), True)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("defgrasp_interfaces: waiting for another build of this environment ...", flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    sys.exit(main())
