"""A gripper's description as URDF, for viewers and planners."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np

from defgrasp_ros.evaluation import FINGER_NAMES
from defgrasp_ros.gripper import Gripper

BASE_LINK, TCP_LINK = "gripper_base", "gripper_tcp"
"""Links at the base of the hand and at the grasp frame; both have the axes of the grasp frame."""

STUB = 0.02
"""Side of the box that stands for the hand of a gripper without palm [m]."""


def gripper_urdf(gripper: Gripper) -> str:
    """Return a URDF document of boxes.

    The joints ``left_finger_joint`` and ``right_finger_joint`` are those of ``~/joint_states``: their position is the
    distance of the pad face from the middle of the hand [m]; the right one mimics the left one. Fillets are not shown.

    Args:
        gripper: Its description.
    """
    robot = ElementTree.Element("robot", name=gripper.name)
    palm = gripper.palm
    half = np.array([palm.half_width, palm.half_length] if palm else [STUB / 2.0, STUB / 2.0])
    face = gripper.hand_to_tcp + palm.face if palm else STUB
    _add_link(robot, BASE_LINK, np.array([*-half, 0.0]), np.array([*half, face]), gripper.hand_mass)
    width = gripper.finger_half_width
    for name, side in zip(FINGER_NAMES, (1.0, -1.0), strict=True):
        depth = sorted((0.0, side * gripper.finger_thickness))
        low = np.array([-width, depth[0], gripper.pad_bottom])
        high = np.array([width, depth[1], gripper.tip])
        _add_link(robot, name, low, high, gripper.finger_mass)
        joint = _add_joint(robot, f"{name}_joint", "prismatic", name, gripper.hand_to_tcp)
        ElementTree.SubElement(joint, "axis", xyz=_numbers([0.0, side, 0.0]))
        limits = {"lower": 0.0, "upper": gripper.max_opening, "effort": gripper.max_force / 2.0}
        limits["velocity"] = gripper.closing_speed
        ElementTree.SubElement(joint, "limit", {key: f"{value:g}" for key, value in limits.items()})
        if name != FINGER_NAMES[0]:
            ElementTree.SubElement(joint, "mimic", joint=f"{FINGER_NAMES[0]}_joint", multiplier="1", offset="0")
    ElementTree.SubElement(robot, "link", name=TCP_LINK)
    _add_joint(robot, "gripper_tcp_joint", "fixed", TCP_LINK, gripper.hand_to_tcp)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


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


def _add_joint(robot: ElementTree.Element, name: str, kind: str, child: str, height: float) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=BASE_LINK)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_numbers([0.0, 0.0, height]))
    return joint


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
