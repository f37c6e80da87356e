"""A gripper's description as URDF, for viewers and planners, on a virtual wrist that puts it anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree import ElementTree

import numpy as np

from defgrasp_ros.evaluation import FINGER_NAMES
from defgrasp_ros.gripper import Gripper

WORLD_LINK, OBJECT_LINK = "world", "object"
"""The root, and the object frame of the grasps; they are the same place."""

BASE_LINK, TCP_LINK = "gripper_base", "gripper_tcp"
"""Links at the base of the hand and at the grasp frame; both have the axes of the grasp frame."""

FINGER_JOINTS = tuple(f"{finger}_joint" for finger in FINGER_NAMES)
"""Prismatic: distance of the pad face from the middle of the hand [m]."""

WRIST_AXES = {
    "wrist_x_joint": ("prismatic", (1.0, 0.0, 0.0)),
    "wrist_y_joint": ("prismatic", (0.0, 1.0, 0.0)),
    "wrist_z_joint": ("prismatic", (0.0, 0.0, 1.0)),
    "wrist_yaw_joint": ("revolute", (0.0, 0.0, 1.0)),
    "wrist_pitch_joint": ("revolute", (0.0, 1.0, 0.0)),
    "wrist_roll_joint": ("revolute", (1.0, 0.0, 0.0)),
}
"""Type and axis of the virtual joints from ``world`` to the base of the hand, in the order of the chain; so the base is
at (x, y, z) [m] with the rotation Rz(yaw) Ry(pitch) Rx(roll) [rad]."""

WRIST_LIMITS = {
    "prismatic": {"lower": -10.0, "upper": 10.0, "effort": 1e3, "velocity": 10.0},
    "revolute": {"lower": -np.pi, "upper": np.pi, "effort": 1e3, "velocity": 30.0},
}
"""URDF asks for some; the simulation has none [m, N, m/s; rad, N m, rad/s]."""

STUB = 0.02
"""Side of the box that stands for the hand of a gripper without palm [m]."""


def gripper_urdf(gripper: Gripper) -> str:
    """Return a URDF document of boxes.

    Its movable joints are those of ``~/joint_states``: the six of the wrist in ``WRIST_AXES``, and ``FINGER_JOINTS``,
    of which the right one mimics the left one. A finger's link has its origin in the middle of the pad face, at the
    height of the grasp frame, and the axes of the grasp frame. Fillets are not shown.

    Args:
        gripper: Its description.
    """
    robot = ElementTree.Element("robot", name=gripper.name)
    palm = gripper.palm
    half = np.array([palm.half_width, palm.half_length] if palm else [STUB / 2.0, STUB / 2.0])
    face = gripper.hand_to_tcp + palm.face if palm else STUB
    _add_wrist(robot)
    _add_link(robot, BASE_LINK, np.array([*-half, 0.0]), np.array([*half, face]), gripper.hand_mass)
    width = gripper.finger_half_width
    for name, side in zip(FINGER_NAMES, (1.0, -1.0), strict=True):
        depth = sorted((0.0, side * gripper.finger_thickness))
        low = np.array([-width, depth[0], gripper.pad_bottom])
        high = np.array([width, depth[1], gripper.tip])
        _add_link(robot, name, low, high, gripper.finger_mass)
        joint = _add_joint(robot, f"{name}_joint", "prismatic", BASE_LINK, name, gripper.hand_to_tcp)
        limits = {"lower": 0.0, "upper": gripper.max_opening, "effort": gripper.max_force / 2.0}
        limits["velocity"] = gripper.closing_speed
        _add_motion(joint, (0.0, side, 0.0), limits)
        if name != FINGER_NAMES[0]:
            ElementTree.SubElement(joint, "mimic", joint=FINGER_JOINTS[0], multiplier="1", offset="0")
    ElementTree.SubElement(robot, "link", name=TCP_LINK)
    _add_joint(robot, "gripper_tcp_joint", "fixed", BASE_LINK, TCP_LINK, gripper.hand_to_tcp)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_wrist(robot: ElementTree.Element) -> None:
    """Add the root, the object frame, and the chain of virtual joints, whose links have neither shape nor mass."""
    parent = WORLD_LINK
    ElementTree.SubElement(robot, "link", name=parent)
    ElementTree.SubElement(robot, "link", name=OBJECT_LINK)
    _add_joint(robot, "object_joint", "fixed", WORLD_LINK, OBJECT_LINK, 0.0)
    for name, (kind, axis) in WRIST_AXES.items():
        is_last = name == list(WRIST_AXES)[-1]
        child = BASE_LINK if is_last else name.replace("_joint", "_link")
        if not is_last:
            ElementTree.SubElement(robot, "link", name=child)
        _add_motion(_add_joint(robot, name, kind, parent, child, 0.0), axis, WRIST_LIMITS[kind])
        parent = child


def _add_link(robot: ElementTree.Element, name: str, low: np.ndarray, high: np.ndarray, mass: float) -> None:
    """Add a link that is a box between two corners [m], of uniform density."""
    link = ElementTree.SubElement(robot, "link", name=name)
    size, middle = high - low, (high + low) / 2.0
    for kind in ("visual", "collision"):
        part = ElementTree.SubElement(link, kind)
        ElementTree.SubElement(part, "origin", xyz=_numbers(middle))
        ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), "box", size=_numbers(size))
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_numbers(middle))
    ElementTree.SubElement(inertial, "mass", value=f"{mass:g}")
    x, y, z = mass / 12.0 * ((size**2).sum() - size**2)
    moments = {"ixx": x, "iyy": y, "izz": z, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
    ElementTree.SubElement(inertial, "inertia", {key: f"{value:.6g}" for key, value in moments.items()})


def _add_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, height: float
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_numbers([0.0, 0.0, height]))
    return joint


def _add_motion(joint: ElementTree.Element, axis: Iterable[float], limits: Mapping[str, float]) -> None:
    ElementTree.SubElement(joint, "axis", xyz=_numbers(axis))
    ElementTree.SubElement(joint, "limit", {key: f"{value:g}" for key, value in limits.items()})


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
