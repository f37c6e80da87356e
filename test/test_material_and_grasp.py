"""Checks of material, grasp and gripper: every number that a caller gives is looked at."""

import math

import numpy as np
import pytest
import yaml

from defgrasp_ros import gripper as gripper_module
from defgrasp_ros.errors import InvalidGraspError, InvalidMaterialError, InvalidOptionsError, NotFoundError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel

HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    "field, value",
    [
        (field, value)
        for field in ("youngs_modulus", "poissons_ratio", "density", "friction_coefficient")
        for value in (math.nan, math.inf, -1.0, "soft", None)
    ]
    + [("youngs_modulus", 0.0), ("density", 0.0), ("friction_coefficient", 0.0), ("poissons_ratio", 0.5)],
)
def test_material_outside_its_range_is_refused(field, value):
    """The error names the field and the value."""
    with pytest.raises(InvalidMaterialError, match=f"material.{field} = ") as caught:
        Material(**{field: value})
    assert (f"{value:g}" if isinstance(value, float) else repr(value)) in str(caught.value)


def test_lame_parameters_give_back_youngs_modulus_and_poissons_ratio():
    """E = mu (3 lambda + 2 mu) / (lambda + mu) and nu = lambda / (2 (lambda + mu))."""
    first, second = Material(youngs_modulus=3e5, poissons_ratio=0.4).lame_parameters
    assert second * (3 * first + 2 * second) / (first + second) == pytest.approx(3e5)
    assert first / (2 * (first + second)) == pytest.approx(0.4)


def test_weight_and_default_target_force():
    """A block of water weighs rho V g, and F_p = 1.3 m g / mu."""
    block = ObjectModel("block", box([0.06, 0.05, 0.02], (2, 2, 1)), Material(density=1000.0, friction_coefficient=0.5))
    assert block.mass == pytest.approx(0.06)
    assert block.weight == pytest.approx(0.06 * 9.81)
    assert block.default_target_force(1.3) == pytest.approx(1.3 * 0.06 * 9.81 / 0.5)
    np.testing.assert_allclose(block.centroid, 0.0, atol=1e-15)


def test_grasp_axes():
    """A quarter turn about x, given x y z w, takes the approach z to -y and the closing axis y to z."""
    grasp = Grasp([0.0, 0.0, 0.1], [HALF, 0.0, 0.0, HALF])
    pad_width, closing, approach = grasp.rotation.T
    np.testing.assert_allclose(pad_width, [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(closing, [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(approach, [0.0, -1.0, 0.0], atol=1e-15)


def test_nearly_normalised_quaternion_is_normalised():
    """Rounding to a few digits, as in a file, is no fault."""
    grasp = Grasp(np.zeros(3), [0.7071, 0.0, 0.0, 0.7071])
    assert np.linalg.norm(grasp.orientation) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    "fields, words",
    [
        ({"position": [0.0, math.nan, 0.0]}, ["position", "nan"]),
        ({"position": [0.0, 0.0]}, ["position", "three"]),
        ({"orientation": [0.0, 0.0, 0.0, 0.0]}, ["orientation", "zero quaternion"]),
        ({"orientation": [0.0, 0.0, 1.0, 1.0]}, ["orientation", "norm 1.41421", "x y z w"]),
        ({"orientation": [0.0, 0.0, math.inf, 1.0]}, ["orientation", "finite"]),
        ({"orientation": [0.0, 0.0, 1.0]}, ["orientation", "four"]),
        ({"target_force": 0.0}, ["target_force = 0 N"]),
        ({"target_force": -2.0}, ["target_force = -2 N"]),
        ({"target_force": math.nan}, ["target_force = nan N"]),
    ],
)
def test_faulty_grasp_is_refused(fields, words):
    """The error names the grasp, the field and the value."""
    with pytest.raises(InvalidGraspError, match="grasp 'top'") as caught:
        Grasp(**{"position": [0.0] * 3, "orientation": [0.0, 0.0, 0.0, 1.0], "id": "top", **fields})
    for word in words:
        assert word in str(caught.value)


def test_default_gripper_is_the_franka_hand():
    """Its pads are 21 x 54 mm, flat within 17 x 49, open by 2 x 44.4 mm, and lie around panda_hand_tcp."""
    franka = load_gripper()
    assert franka.name == "franka_hand"
    assert 2.0 * franka.pad_half_width == pytest.approx(0.017)
    assert franka.pad_top - franka.pad_bottom == pytest.approx(0.049)
    assert 2.0 * franka.finger_half_width == pytest.approx(0.021)
    assert franka.tip - franka.pad_bottom == pytest.approx(0.054)
    assert (franka.side_fillet, franka.tip_fillet) == (0.002, 0.005)
    assert franka.palm.face + franka.hand_to_tcp == pytest.approx(0.066)
    assert franka.pad_bottom < 0.0 < franka.pad_top < franka.tip
    assert franka.max_opening == pytest.approx(0.044442)
    assert franka.hand_to_tcp == pytest.approx(0.1034)


def test_unknown_gripper():
    """The error lists those that exist."""
    with pytest.raises(NotFoundError, match="'claw' is unknown; known: .*franka_hand"):
        load_gripper("claw")


@pytest.mark.parametrize(
    "line, error_words",
    [
        ("max_opening: -0.04", ["gripper.max_opening = -0.04 m"]),
        ("pad_top: -0.05", ["gripper.pad_top"]),
        ("tip: 0.0", ["gripper.tip"]),
        ("side_fillet: -0.001", ["gripper.side_fillet = -0.001 m"]),
        ("tip_fillet: 0.006", ["gripper.tip = 0.009 m"]),
        ("palm: {face: 0.05, half_width: 0.03, half_length: 0.1}", ["gripper.palm.face = 0.05 m"]),
        ("palm: {face: -0.03}", ["half_width"]),
        ("palm: wide", ["palm"]),
        ("max_force: .nan", ["gripper.max_force = nan N"]),
        ("colour: 3", ["colour"]),
    ],
)
def test_faulty_gripper_file_is_refused(tmp_path, monkeypatch, line, error_words):
    """A value out of range and an unknown key are named."""
    text = gripper_module.config_file("grippers/franka_hand.yaml").read_text()
    values = yaml.safe_load(text) | yaml.safe_load(line)
    path = tmp_path / "claw.yaml"
    path.write_text(yaml.safe_dump(values))
    monkeypatch.setattr(gripper_module, "config_file", lambda relative: path)
    with pytest.raises(InvalidOptionsError) as caught:
        load_gripper("claw")
    for word in error_words:
        assert word in str(caught.value)


def test_pad_drop_is_a_circular_arc():
    """Flat in the middle, a fillet's radius behind at the ends, and both where they meet."""
    franka = load_gripper()
    side, tip = franka.side_fillet, franka.tip_fillet
    x, z = franka.pad_half_width, franka.pad_top
    across = np.array([0.0, x, x + side, -x - 0.6 * side, 0.0, x + side])
    along = np.array([-0.045, z, 0.0, 0.0, z + tip, z + tip])
    drop = franka.pad_drop(across, along)
    np.testing.assert_allclose(drop, [0.0, 0.0, side, 0.2 * side, tip, side + tip], atol=1e-12)
