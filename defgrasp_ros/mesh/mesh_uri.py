"""Mesh files named by URI: which file that is, and whether it may be read."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from defgrasp_ros.errors import InvalidMeshError, NotFoundError

FILE_SCHEME, PACKAGE_SCHEME = "file://", "package://"
PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def path_of_uri(uri: str, allowed: Sequence[Path] = ()) -> Path:
    """Return the file of a URI, percent signs decoded.

    Args:
        uri: ``file:///absolute/path``, or ``package://name/path`` below the share folder of a ROS package, from which
            a path cannot lead out.
        allowed: Folders in or below which the file must be when links are followed; empty: anywhere.

    Raises:
        NotFoundError: If there is no such package.
        InvalidMeshError: If the URI has another scheme, names another machine, is not absolute, leads out of its
            package, or to a place that is not allowed.
    """
    text = unquote(uri)
    if "\0" in text:
        raise InvalidMeshError(f"{uri[:80]!r} holds a zero byte, which no path has")
    if text.startswith(PACKAGE_SCHEME):
        path = _path_in_package(uri, text.removeprefix(PACKAGE_SCHEME))
    else:
        location = text.removeprefix(FILE_SCHEME).removeprefix("localhost")
        if not text.startswith(FILE_SCHEME) or not location.startswith("/"):
            raise InvalidMeshError(
                f"'{uri}' cannot be read; give file:// and an absolute path on the evaluator's machine, e.g. "
                "file:///home/me/banana.stl, or package://name/path, or send the content in object.data"
            )
        path = Path(location).resolve()
    folders = [folder.expanduser().resolve() for folder in allowed]
    if folders and not any(path.resolve().is_relative_to(folder) for folder in folders):
        listed = ", ".join(map(str, folders))
        raise InvalidMeshError(
            f"'{uri}' may not be read: it is in none of the evaluator's mesh_directories ({listed}); put the file "
            "there, or send the content in object.data"
        )
    return path


def _path_in_package(uri: str, location: str) -> Path:
    name, _, relative = location.partition("/")
    if not PACKAGE_NAME.fullmatch(name) or not relative:
        raise InvalidMeshError(
            f"'{uri}' is no package:// URI; give package://name/path, e.g. package://my_objects/a.stl"
        )
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    shares = [Path(prefix).resolve() / "share" / name for prefix in prefixes]
    share = next((folder for folder in shares if folder.is_dir()), None)
    if share is None:
        raise NotFoundError(f"'{uri}': package '{name}' is not in AMENT_PREFIX_PATH; source its workspace")
    # Files of a workspace built with links lead to its sources; only the path itself must stay inside.
    path = Path(os.path.normpath(share / relative.lstrip("/")))
    if not path.is_relative_to(share):
        raise InvalidMeshError(f"'{uri}' leads out of package '{name}'; give a path inside of it")
    return path
