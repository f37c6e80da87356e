"""Which file a URI means, and whether it may be read."""

from pathlib import Path

import pytest

from defgrasp_ros.errors import InvalidMeshError, NotFoundError
from defgrasp_ros.mesh.mesh_uri import path_of_uri


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A ROS package ``toys`` with one file."""
    folder = tmp_path / "share" / "toys"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "a.stl").write_text("")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    return folder


@pytest.mark.parametrize("uri", ["file:///a%20b.stl", "file://localhost/a b.stl", "file:///c/../a b.stl"])
def test_file_uri_is_decoded(uri):
    """Percent signs are decoded, and the own machine may be named."""
    assert path_of_uri(uri) == Path("/a b.stl")


@pytest.mark.parametrize("uri", ["a.stl", "/a.stl", "file://a.stl", "http://host/a.stl", "", "ftp:///a.stl"])
def test_other_uri_is_refused(uri):
    """Relative paths and other schemes are refused; the text says what to write."""
    with pytest.raises(InvalidMeshError, match="file://"):
        path_of_uri(uri)


def test_package_uri_is_found(package):
    """A package's files are below its share folder; a package that is not there is named."""
    assert path_of_uri("package://toys/meshes/a.stl") == package.resolve() / "meshes" / "a.stl"
    with pytest.raises(NotFoundError, match="package 'robot'"):
        path_of_uri("package://robot/a.stl")


@pytest.mark.parametrize(
    "uri",
    [
        "package://toys/../../secret.stl",
        "package://toys/%2e%2e/%2e%2e/secret.stl",
        "package://toys/meshes/../../other/a.stl",
        "package://../toys/a.stl",
        "package://toys",
        "package:///a.stl",
    ],
)
def test_no_path_leads_out_of_a_package(package, uri):
    """Whatever is written after the package's name stays inside of it."""
    with pytest.raises(InvalidMeshError, match="package"):
        path_of_uri(uri)


def test_only_allowed_folders_are_read(tmp_path):
    """Neither dots nor links lead out of the allowed folders."""
    allowed, outside = tmp_path / "allowed", tmp_path / "outside"
    allowed.mkdir()
    outside.mkdir()
    (allowed / "link").symlink_to(outside)
    inside = allowed / "a.stl"
    assert path_of_uri(inside.as_uri(), [allowed]) == inside.resolve()
    for path in ("outside/a.stl", "allowed/../outside/a.stl", "allowed/link/a.stl", "allowedly/a.stl"):
        with pytest.raises(InvalidMeshError, match="mesh_directories"):
            path_of_uri(f"file://{tmp_path}/{path}", [allowed])


def test_links_of_a_package_do_not_lead_out_of_the_allowed_folders(package, tmp_path):
    """A link inside of a package is followed before the folders are compared."""
    (package / "link").symlink_to(tmp_path)
    assert path_of_uri("package://toys/meshes/a.stl", [package])
    with pytest.raises(InvalidMeshError, match="mesh_directories"):
        path_of_uri("package://toys/link/secret.stl", [package])


def test_zero_byte_is_refused():
    """It would end the path for the operating system."""
    with pytest.raises(InvalidMeshError, match="zero byte"):
        path_of_uri("file:///a.stl%00.txt")
