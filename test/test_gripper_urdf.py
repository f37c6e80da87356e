"""Grippers of the package, and their URDF."""

from xml.etree import ElementTree

import numpy as np
import pytest

from defgrasp_ros.gripper import gripper_names, load_gripper
from defgrasp_ros.gripper_urdf import gripper_urdf


def numbers(text):
    return np.array([float(word) for word in text.split()])


def test_there_are_three_grippers():
    """The hand of the original, an industrial gripper, and one with round pads."""
    assert {"franka_hand", "robotiq_2f_85", "round_pads"} <= set(gripper_names())


@pytest.mark.parametrize("name", gripper_names())
def test_pads_of_the_urdf_are_where_the_description_has_them(name):
    """At opening q each finger's box begins q from the middle, and has the outline of the description."""
    hand = load_gripper(name)
    robot = ElementTree.fromstring(gripper_urdf(hand).encode())
    opening = hand.max_opening / 2.0
    for side, finger in ((1.0, "left_finger"), (-1.0, "right_finger")):
        joint = robot.find(f"joint[@name='{finger}_joint']")
        assert float(joint.find("limit").get("upper")) == pytest.approx(hand.max_opening, rel=1e-5)
        box = robot.find(f"link[@name='{finger}']/visual")
        place = numbers(joint.find("origin").get("xyz")) + opening * numbers(joint.find("axis").get("xyz"))
        middle = place + numbers(box.find("origin").get("xyz"))
        half = numbers(box.find("geometry/box").get("size")) / 2.0
        low, high = middle - half, middle + half
        inner = low[1] if side > 0.0 else high[1]
        assert inner == pytest.approx(side * opening, abs=1e-6)
        assert high[2] - hand.hand_to_tcp == pytest.approx(hand.tip, abs=1e-6)
        assert low[2] - hand.hand_to_tcp == pytest.approx(hand.pad_bottom, abs=1e-6)
        assert high[0] == pytest.approx(hand.finger_half_width, abs=1e-6)
    mimic = robot.find("joint[@name='right_finger_joint']/mimic")
    assert mimic.get("joint") == "left_finger_joint"
    tcp = robot.find("joint[@name='gripper_tcp_joint']/origin")
    assert numbers(tcp.get("xyz"))[2] == pytest.approx(hand.hand_to_tcp)


@pytest.mark.parametrize("name", gripper_names())
def test_urdf_is_a_tree_with_sound_masses(name):
    """Each link but the world is the child of one joint, and inertias obey the triangle inequality."""
    robot = ElementTree.fromstring(gripper_urdf(load_gripper(name)).encode())
    links = {link.get("name") for link in robot.findall("link")}
    children = [joint.find("child").get("link") for joint in robot.findall("joint")]
    assert links - set(children) == {"world"} and len(children) == len(set(children))
    for inertia in robot.iter("inertia"):
        x, y, z = (float(inertia.get(key)) for key in ("ixx", "iyy", "izz"))
        assert min(x, y, z) > 0.0 and 2.0 * max(x, y, z) < x + y + z + 1e-12
