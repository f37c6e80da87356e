"""The interface definitions say the same as the data classes; read as text, so no ROS is needed."""

import dataclasses
import re
from enum import IntEnum
from pathlib import Path

import pytest

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import (
    AccelerationResult,
    DeformedState,
    EvaluationOptions,
    FingerContact,
    GraspEvaluation,
    GraspFeatures,
    GraspMetrics,
    Phase,
    PickupCourse,
    ReorientationResult,
    SolverReport,
    SqueezeResult,
)
from defgrasp_ros.material import Material

DEFINITIONS = Path(__file__).resolve().parents[1] / "msg_defs"
MESSAGES = sorted(DEFINITIONS.glob("msg/*.msg"))
CONSTANT = re.compile(r"^\w+ ([A-Z][A-Z0-9_]*)\s*=\s*(\d+)")
FIELD = re.compile(r"^[\w/]+(?:\[(?:<=)?\d*\])? ([a-z][a-z0-9_]*)(?: ([^\s#]+))?\s*(?:#.*)?$")


def constants(message: str) -> dict[str, int]:
    """Return name -> value of a message's constants."""
    matches = map(CONSTANT.match, (DEFINITIONS / f"msg/{message}.msg").read_text().splitlines())
    return {match[1]: int(match[2]) for match in matches if match}


def fields(message: str) -> dict[str, str | None]:
    """Return name -> default (as text) of a message's fields."""
    matches = map(FIELD.match, (DEFINITIONS / f"msg/{message}.msg").read_text().splitlines())
    return {match[1]: match[2] for match in matches if match}


def members(enum: type[IntEnum], prefix: str = "") -> dict[str, int]:
    """Return name -> value of an enumeration, names with the message's prefix."""
    return {prefix + member.name: member.value for member in enum}


def attributes(data_class: type) -> set[str]:
    """Return the field names of a data class."""
    return {attribute.name for attribute in dataclasses.fields(data_class)}


def test_result_constants_are_the_result_codes():
    """Every result code has a constant of its name and number, and there is no other."""
    assert constants("Result") == members(ResultCode)


def test_status_phases_are_the_phases():
    """Every phase has a constant of its name and number, and there is no other."""
    phases = {name: value for name, value in constants("EvaluatorStatus").items() if name.startswith("PHASE_")}
    assert phases == members(Phase, "PHASE_")


@pytest.mark.parametrize(
    ("message", "data_class"),
    [
        ("AccelerationResult", AccelerationResult),
        ("GraspFeatures", GraspFeatures),
        ("GraspMetrics", GraspMetrics),
        ("Material", Material),
        ("ObjectField", DeformedState),
        ("PickupCourse", PickupCourse),
        ("ReorientationResult", ReorientationResult),
        ("SolverReport", SolverReport),
        ("SqueezeResult", SqueezeResult),
    ],
)
def test_message_has_the_fields_of_the_data_class(message, data_class):
    """Message and data class have the same fields; a field's stage is the key of the class's dictionary."""
    assert set(fields(message)) - {"stage"} == attributes(data_class)


def test_options_have_the_fields_of_the_data_class():
    """The message has all options of an evaluation, and besides them only what concerns the node."""
    assert set(fields("ExperimentOptions")) == attributes(EvaluationOptions) | {"record"}


def test_evaluation_has_the_fields_of_the_data_class():
    """The message packs code and text into a result, the time of the end into a header; all else has its name."""
    packed = {"code", "message", "end_time"}
    assert set(fields("GraspEvaluation")) - {"header", "result"} == attributes(GraspEvaluation) - packed


def test_finger_contact_has_the_fields_and_sums_of_the_data_class():
    """The message carries the fields of the class and those properties that are sums over the contact points."""
    sums = {"count", "normal_force", "tangential_force", "centroid"}
    assert all(isinstance(getattr(FingerContact, name), property) for name in sums)
    assert set(fields("FingerContact")) == attributes(FingerContact) | sums


def test_material_defaults_are_those_of_the_data_class():
    """A material message left alone means the default material."""
    defaults = {attribute.name: attribute.default for attribute in dataclasses.fields(Material)}
    assert {name: float(default) for name, default in fields("Material").items()} == defaults


def test_every_definition_is_generated():
    """No definition is forgotten in the build file."""
    listed = re.findall(r"^ +((?:action|msg|srv)/\S+)$", (DEFINITIONS / "CMakeLists.txt").read_text(), re.MULTILINE)
    present = [path.relative_to(DEFINITIONS).as_posix() for path in DEFINITIONS.glob("*/*.*")]
    assert sorted(listed) == sorted(present)


@pytest.mark.parametrize("path", MESSAGES, ids=lambda path: path.stem)
def test_every_number_has_a_unit(path):
    """A number means nothing without its unit; enumerations and bytes have none."""
    numbers = [line for line in path.read_text().splitlines() if re.match(r"u?(int|float)\d+(\[\])? [a-z]", line)]
    without_unit = {line.split()[1] for line in numbers if not re.search(r"#.*\[[^\]]+\]", line)}
    assert without_unit <= {"code", "state", "phase", "data"}
