"""Messages and domain objects say the same thing, and what a message may not say is refused with its reason."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import (
    InvalidGraspError,
    InvalidMaterialError,
    InvalidMeshError,
    InvalidOptionsError,
    MeshNotWatertightError,
    MeshTooLargeError,
    NotFoundError,
    ResultCode,
    UnknownFrameError,
)
from defgrasp_ros.evaluation import (
    AccelerationResult,
    DeformedState,
    EvaluationOptions,
    Experiment,
    FingerContact,
    GraspEvaluation,
    GraspFeatures,
    GraspMetrics,
    PickupCourse,
    ReorientationResult,
    SolverReport,
    SqueezeResult,
)
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.option import options_of

msg = pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")
pytest.importorskip("rclpy")

from defgrasp_ros.ros.fields import time_message  # noqa: E402
from defgrasp_ros.ros.object_registry import ObjectRegistry  # noqa: E402
from defgrasp_ros.ros.object_source import MeshData, MeshFile, RegisteredObject, Surface  # noqa: E402
from defgrasp_ros.ros.parameters import EXPERIMENT, PARAMETERS, parameters_markdown, parameters_yaml  # noqa: E402
from defgrasp_ros.ros.request_conversion import (  # noqa: E402
    grasp_from_message,
    grasp_to_message,
    material_from_message,
    material_to_message,
    object_from_message,
    object_to_message,
    options_from_message,
    options_to_message,
)
from defgrasp_ros.ros.result_conversion import NUMBERS, evaluation_from_message, evaluation_to_message  # noqa: E402

BLOCK = box((0.04, 0.03, 0.02), (2, 2, 1))
LIMIT = 10_000
STAMP = time_message(12_000_000_034)


def contact(name: str, count: int) -> FingerContact:
    """Contacts with numbers of their own."""
    values = np.arange(3.0 * count).reshape(count, 3)
    normals = np.tile([0.0, 1.0, 0.0], (count, 1))
    return FingerContact(name, positions=values, normals=normals, forces=values + 0.5, slipping=count == 2)


def tetrahedra_text() -> str:
    """The block as a .tet file."""
    vertices = [f"v {x!r} {y!r} {z!r}" for x, y, z in BLOCK.vertices.tolist()]
    return "\n".join(vertices + [f"t {a} {b} {c} {d}" for a, b, c, d in BLOCK.tetrahedra.tolist()])


def test_material_survives_the_message() -> None:
    """A material comes back as it went, and an untouched message is the default material."""
    material = Material(youngs_modulus=1.5e4, poissons_ratio=0.45, density=987.0, friction_coefficient=0.3)
    assert material_from_message(material_to_message(material)) == material
    assert material_from_message(msg.Material()) == Material()


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", ["youngs_modulus", "density", "friction_coefficient"])
def test_impossible_material_is_refused(name: str, value: float) -> None:
    """The text names the field and the value."""
    with pytest.raises(InvalidMaterialError, match=f"{name} = {value:g}"):
        material_from_message(msg.Material(**{name: value}))


def test_grasp_survives_the_message() -> None:
    """A grasp comes back as it went, with its quaternion in the same order."""
    orientation = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    grasp = Grasp(np.array([0.01, -0.02, 0.03]), orientation, id="tilted", target_force=2.5)
    back = grasp_from_message(grasp_to_message(grasp))
    assert (back.id, back.target_force) == ("tilted", 2.5)
    np.testing.assert_array_equal(back.position, grasp.position)
    np.testing.assert_allclose(back.orientation, grasp.orientation, rtol=1e-15)


def test_target_force_zero_is_the_default_force() -> None:
    """A message whose target force is 0 leaves the force to the evaluator."""
    assert grasp_from_message(msg.Grasp()).target_force is None
    assert grasp_to_message(Grasp(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))).target_force == 0.0


def test_grasp_in_an_unknown_frame_is_refused() -> None:
    """Only the object frame is known; the text names the frame and the one to use."""
    message = msg.Grasp(id="top")
    message.pose.header.frame_id = "object"
    grasp_from_message(message)
    message.pose.header.frame_id = "camera"
    with pytest.raises(UnknownFrameError, match="'top'.*'camera'.*'object'"):
        grasp_from_message(message)


@pytest.mark.parametrize("x, w", [(0.0, 0.0), (0.0, 2.0), (math.nan, 1.0)])
def test_grasp_without_a_unit_quaternion_is_refused(x: float, w: float) -> None:
    """Zero, unnormalised and not finite quaternions name the grasp."""
    message = msg.Grasp(id="top")
    message.pose.pose.orientation.x = x
    message.pose.pose.orientation.w = w
    with pytest.raises(InvalidGraspError, match="'top'"):
        grasp_from_message(message)


def test_options_survive_the_message_and_zero_takes_the_default() -> None:
    """What is given is kept; numbers left 0, and experiments left empty, are the evaluator's."""
    doubled = {name: 2 * option.default for name, option in options_of(EvaluationOptions).items()}
    doubled |= {"reorientation_settles": False, "return_fields": True}
    options = EvaluationOptions(**doubled, experiments={"squeeze", "linear_acceleration"})
    assert options_from_message(options_to_message(options), EvaluationOptions()) == options
    only_hold = msg.ExperimentOptions(pickup_hold_time=1.0)
    expected = dataclasses.replace(options, pickup_hold_time=1.0, return_fields=False)
    assert options_from_message(only_hold, options) == expected


def test_experiments_of_a_message_are_names() -> None:
    """The message has the names in the order in which the experiments are done; an unknown one is refused by name."""
    message = options_to_message(EvaluationOptions(experiments=frozenset(Experiment)))
    assert list(message.experiments) == [experiment.value for experiment in Experiment]
    everything = options_from_message(msg.ExperimentOptions(experiments=["all"]), EvaluationOptions())
    assert everything.experiments == frozenset(Experiment)
    with pytest.raises(InvalidOptionsError, match="options.experiments: 'shake' is unknown; known are pickup, "):
        options_from_message(msg.ExperimentOptions(experiments=["shake"]), EvaluationOptions())


@pytest.mark.parametrize(
    "name", [name for name, option in options_of(EvaluationOptions).items() if option.kind is not bool]
)
def test_option_out_of_its_range_is_refused(name: str) -> None:
    """The text names the option, the value and the range."""
    high = options_of(EvaluationOptions)[name].high
    value = type(getattr(msg.ExperimentOptions(), name))(2 * high)
    with pytest.raises(InvalidOptionsError, match=re.escape(f"options.{name} = {value:g}") + ".* is outside .*, .*]"):
        options_from_message(msg.ExperimentOptions(**{name: value}), EvaluationOptions())


@pytest.mark.parametrize("value", [-1.0, math.nan])
def test_impossible_option_is_refused(value: float) -> None:
    """Negative and not finite numbers are no way to say "default"."""
    with pytest.raises(InvalidOptionsError, match=f"pickup_hold_time = {value:g}"):
        options_from_message(msg.ExperimentOptions(pickup_hold_time=value), EvaluationOptions())


def test_tetrahedra_survive_the_message() -> None:
    """Ready tetrahedra are used as they are."""
    model = object_from_message(object_to_message(BLOCK, Material(), "block"), LIMIT)
    assert model.name == "block"
    np.testing.assert_array_equal(model.mesh.vertices, BLOCK.vertices)
    np.testing.assert_array_equal(model.mesh.tetrahedra, BLOCK.tetrahedra)


def test_file_and_data_give_the_same_mesh(tmp_path: Path) -> None:
    """A file is found under a name that needs escaping, and its content sent as bytes is the same object."""
    path = tmp_path / "block 100%#1.tet"
    path.write_text(tetrahedra_text())
    by_file = object_from_message(object_to_message(MeshFile(path, scale=0.5), Material()), LIMIT)
    data = MeshData(path.read_bytes(), "tet", scale=0.5)
    by_data = object_from_message(object_to_message(data, Material()), LIMIT)
    np.testing.assert_allclose(by_file.mesh.vertices, 0.5 * BLOCK.vertices)
    np.testing.assert_array_equal(by_file.mesh.vertices, by_data.mesh.vertices)


def test_a_registered_object_has_its_own_name():
    """Logs and reports name a registered object as the registry does, unless the request says otherwise."""
    assert object_to_message(RegisteredObject("lemon"), Material()).name == "lemon"
    assert object_to_message(RegisteredObject("lemon"), Material(), "my lemon").name == "my lemon"


def test_surface_encloses_the_same_volume() -> None:
    """A closed surface is filled with tetrahedra."""
    source = Surface(BLOCK.vertices, BLOCK.surface_triangles, target_edge_length=0.01)
    model = object_from_message(object_to_message(source, Material()), LIMIT)
    assert model.mesh.volume == pytest.approx(BLOCK.volume, rel=1e-3)


@pytest.mark.parametrize("asked, made", [(None, 2), (1, 1), (2, 2)])
def test_element_order_of_a_surface(asked, made) -> None:
    """It is 2 unless the request says otherwise."""
    source = Surface(BLOCK.vertices, BLOCK.surface_triangles, target_edge_length=0.02, element_order=asked)
    assert object_from_message(object_to_message(source, Material()), LIMIT).mesh.element_order == made


def test_element_order_of_tetrahedra(tmp_path: Path) -> None:
    """Given ones stay as they are, with the nodes in the middle of edges if they have any."""
    for order in (1, 2):
        sent = dataclasses.replace(BLOCK, element_order=order)
        mesh = object_from_message(object_to_message(sent, Material()), LIMIT).mesh
        assert mesh.element_order == order
        np.testing.assert_array_equal(mesh.vertices, sent.vertices)
    path = tmp_path / "block.tet"
    path.write_text(tetrahedra_text())
    for asked, used in ((None, 1), (1, 1), (2, 2)):
        message = object_to_message(MeshFile(path, element_order=asked), Material())
        assert object_from_message(message, LIMIT).mesh.element_order == used


def test_element_order_that_does_not_exist_is_refused() -> None:
    """The text says which there are."""
    message = object_to_message(BLOCK, Material())
    message.element_order = 3
    with pytest.raises(InvalidMeshError, match="object.tetrahedra: element_order = 3 is not available; give 1 or 2"):
        object_from_message(message, LIMIT)


def test_element_order_of_objects_by_name() -> None:
    """Those of the library are made as asked for; registered ones are what they are."""
    registry = ObjectRegistry()
    registry.add("brick", BLOCK)

    def order(name: str, asked: int | None) -> int:
        message = object_to_message(RegisteredObject(name, asked), Material())
        return object_from_message(message, LIMIT, registry=registry).mesh.element_order

    assert [order("cup", asked) for asked in (None, 1, 2)] == [2, 1, 2]
    assert [order("brick", asked) for asked in (None, 1)] == [1, 1]
    with pytest.raises(InvalidMeshError, match="element_order = 2, but object 'brick' is registered with 1"):
        order("brick", 2)


def test_open_surface_is_refused() -> None:
    """A surface without one of its triangles is not watertight."""
    source = Surface(BLOCK.vertices, BLOCK.surface_triangles[1:])
    with pytest.raises(MeshNotWatertightError):
        object_from_message(object_to_message(source, Material()), LIMIT)


def test_shape_must_be_given_exactly_once() -> None:
    """No shape, and two shapes, are refused by name."""
    with pytest.raises(InvalidMeshError, match="given by nothing"):
        object_from_message(msg.ObjectModel(), LIMIT)
    both = object_to_message(BLOCK, Material())
    both.uri = "file:///block.tet"
    with pytest.raises(InvalidMeshError, match="uri and tetrahedra"):
        object_from_message(both, LIMIT)


def test_too_many_tetrahedra_are_refused() -> None:
    """The text names the number and the limit."""
    with pytest.raises(MeshTooLargeError, match=f"{len(BLOCK.tetrahedra)}.*= 5"):
        object_from_message(object_to_message(BLOCK, Material()), 5)


def test_incomplete_vertex_is_refused() -> None:
    """A flat array that is no multiple of three is named with its length."""
    message = object_to_message(BLOCK, Material())
    message.tetrahedra.vertices.pop()
    with pytest.raises(InvalidMeshError, match=r"object\.tetrahedra: vertices has 53 numbers"):
        object_from_message(message, LIMIT)


@pytest.mark.parametrize("scale", [-1.0, math.nan])
def test_impossible_scale_is_refused(scale: float) -> None:
    """A scale is positive, or 0 for none."""
    message = object_to_message(BLOCK, Material())
    message.scale = scale
    with pytest.raises(InvalidMeshError, match=r"object\.scale"):
        object_from_message(message, LIMIT)


def test_registered_object_is_found_by_its_name() -> None:
    """A request names a registered object, or one of the library; the material is the request's."""
    registry = ObjectRegistry()
    registry.add("brick", BLOCK)
    message = object_to_message(RegisteredObject("brick"), Material(density=7.0))
    model = object_from_message(message, LIMIT, registry=registry)
    assert model.mesh is BLOCK and model.material.density == 7.0
    cup = object_from_message(object_to_message(RegisteredObject("cup"), Material()), LIMIT)
    assert len(cup.mesh.vertices) > 800
    with pytest.raises(NotFoundError, match="'brick' is neither registered"):
        object_from_message(message, LIMIT)


def test_files_outside_of_the_allowed_folders_are_refused(tmp_path: Path) -> None:
    """The restriction holds for requests."""
    message = object_to_message(MeshFile(tmp_path / "a.stl"), Material())
    with pytest.raises(InvalidMeshError, match="object.uri.*mesh_directories"):
        object_from_message(message, LIMIT, [tmp_path / "allowed"])


def test_missing_file_is_not_found(tmp_path: Path) -> None:
    """The text names the path."""
    with pytest.raises(NotFoundError, match="missing.stl"):
        object_from_message(object_to_message(MeshFile(tmp_path / "missing.stl"), Material()), LIMIT)


def test_evaluation_survives_the_message() -> None:
    """All of a result comes back; fields over the mesh in single precision."""
    evaluation = GraspEvaluation(
        grasp_index=3,
        grasp_id="top",
        code=ResultCode.DROPPED,
        message="slipped",
        features=GraspFeatures(0.1, 0.2, 7.5, 0.3, 0.4, 0.5, 0.6),
        metrics=GraspMetrics(True, 1e4, 0.002, 0.03, 12.0, 345.0, 0.004),
        target_force=2.0,
        applied_force=1.99,
        contacts=(contact("left_finger", 2), contact("right_finger", 0)),
        palm_force=np.array([0.1, -0.2, 0.3]),
        slip_distance=0.001,
        holding_time=1.25,
        loss_of_contact_time=2.5,
        stress_error=150.0,
        deformation_error=1e-5,
        simulated_time=3.5,
        wall_time=0.75,
        solver=SolverReport(False, 10, 20, 1e-9, 1, 2),
        fields={"post_pickup": DeformedState(BLOCK.vertices, np.arange(len(BLOCK.tetrahedra)), 0.015)},
    )
    message = evaluation_to_message(evaluation, STAMP)
    back = evaluation_from_message(message)
    assert (message.header.stamp, message.header.frame_id) == (STAMP, "object")
    for name in ("grasp_index", "grasp_id", "code", "message", "features", "metrics", "solver"):
        assert getattr(back, name) == getattr(evaluation, name)
    for name in NUMBERS:
        assert getattr(back, name) == getattr(evaluation, name)
    np.testing.assert_array_equal(back.palm_force, evaluation.palm_force)
    assert back.contacts is not None
    for contact_back, contact_there in zip(back.contacts, evaluation.contacts, strict=True):
        assert (contact_back.name, contact_back.slipping) == (contact_there.name, contact_there.slipping)
        np.testing.assert_array_equal(contact_back.positions, contact_there.positions)
        np.testing.assert_array_equal(contact_back.normals, contact_there.normals)
        np.testing.assert_array_equal(contact_back.forces, contact_there.forces)
    state = back.fields["post_pickup"]
    np.testing.assert_array_equal(state.positions, BLOCK.vertices.astype(np.float32))
    np.testing.assert_array_equal(state.von_mises_stress, np.arange(len(BLOCK.tetrahedra)))
    assert state.opening == 0.015
    assert not evaluation_to_message(evaluation.without_fields(), STAMP).fields and evaluation.fields


def test_experiments_survive_the_message() -> None:
    """Every number, mark and reason of the experiments comes back, fields over the mesh where they are wanted."""
    directions, state = np.arange(48.0).reshape(16, 3), DeformedState(BLOCK.vertices, np.arange(3.0), 0.015)
    some = np.where(np.arange(16) % 3, np.arange(16.0), np.nan)
    reasons = ["" if number == number else "no solution" for number in some]
    turned = [np.arange(64.0).reshape(16, 4) + start for start in (0.0, 100.0, 200.0, 300.0)]
    squeezed = [np.array([1.0, 2.0, np.nan]) + start for start in (0.0, 10.0, 20.0, 30.0, 40.0)]
    evaluation = GraspEvaluation(
        0,
        "top",
        pickup=PickupCourse(squeezed[0], np.array([3, 3, 5]), *squeezed[1:], squeezed[0], squeezed[1]),
        reorientation=ReorientationResult(directions, 2.5, *turned, reasons, {(3, 1): state, (15, 3): state}),
        linear_acceleration=AccelerationResult(directions, some, some + 1.0, some > 10.0, reasons),
        angular_acceleration=AccelerationResult(directions, some + 2.0, some, some > 5.0, reasons),
        squeeze=SqueezeResult(
            *squeezed, [(contact("left_finger", 2), contact("right_finger", 1))] * 2, [state] * 2, "at 3 N: no solution"
        ),
    )
    back = evaluation_from_message(evaluation_to_message(evaluation, STAMP))
    for name in ("pickup", "reorientation", "linear_acceleration", "angular_acceleration", "squeeze"):
        result, there = getattr(back, name), getattr(evaluation, name)
        for field in dataclasses.fields(there):
            if field.name not in ("states", "contacts"):
                np.testing.assert_array_equal(getattr(result, field.name), getattr(there, field.name))
    assert back.reorientation is not None and set(back.reorientation.states) == {(3, 1), (15, 3)}
    assert back.squeeze is not None and len(back.squeeze.states) == 2
    assert [[finger.count for finger in fingers] for fingers in back.squeeze.contacts] == [[2, 1], [2, 1]]
    for deformed in (*back.reorientation.states.values(), *back.squeeze.states):
        np.testing.assert_array_equal(deformed.positions, BLOCK.vertices.astype(np.float32))
    bare = evaluation_to_message(evaluation.without_fields(), STAMP)
    assert not bare.reorientation[0].states and not bare.squeeze[0].states


def test_evaluation_that_measured_nothing_survives_the_message() -> None:
    """Not measured stays nan, and no contact stays none."""
    back = evaluation_from_message(evaluation_to_message(GraspEvaluation(0, ""), STAMP))
    assert back.contacts is None
    assert back.reorientation is back.linear_acceleration is back.angular_acceleration is back.squeeze is None
    assert back.pickup is None and np.isnan(back.palm_force).all()
    assert math.isnan(back.metrics.strain_energy)
    assert math.isnan(back.target_force)


def test_parameter_file_is_that_of_the_table() -> None:
    """config/evaluator.yaml is what the table of parameters prints."""
    assert config_file("evaluator.yaml").read_text() == parameters_yaml()


def test_parameter_table_of_the_documentation_is_that_of_the_code() -> None:
    """docs/ros.md has the table that the code prints."""
    page = (Path(__file__).resolve().parents[1] / "docs" / "ros.md").read_text()
    assert parameters_markdown() in page


def test_parameter_file_may_be_taken_as_it_is_or_in_full() -> None:
    """What a user keeps or fills in has the names of the table; only what the preset decides about is left out."""

    def names(values: dict, prefix: str = "") -> Iterator[str]:
        for name, value in values.items():
            yield from names(value, f"{prefix}{name}.") if isinstance(value, dict) else [prefix + name]

    def read(text: str) -> set[str]:
        return set(names(yaml.safe_load(text)["/**"]["ros__parameters"]))

    every = {parameter.name for parameter in PARAMETERS}
    assert read(parameters_yaml()) == {name for name in every if not name.startswith(EXPERIMENT)}
    assert read(parameters_yaml().replace("#: ", "")) == every


def test_every_option_has_its_parameter() -> None:
    """What belongs to the protocol has a parameter; whether fields are returned is the caller's own decision."""
    options = [field.name for field in dataclasses.fields(EvaluationOptions) if field.name != "return_fields"]
    parameters = [row.name.removeprefix(EXPERIMENT) for row in PARAMETERS if row.name.startswith(EXPERIMENT)]
    assert parameters == options


def test_states_settle_where_request_and_evaluator_say_so() -> None:
    """A bool of a message has no third value, so either side can switch settling off."""
    for asked in (True, False):
        for own in (True, False):
            message = msg.ExperimentOptions(reorientation_settles=asked)
            options = options_from_message(message, EvaluationOptions(reorientation_settles=own))
            assert options.reorientation_settles is (asked and own)


def test_booleans_of_a_message_left_alone_are_the_defaults() -> None:
    """A boolean cannot be left out, so the message's own default is that of the options."""
    assert msg.ExperimentOptions().reorientation_settles is EvaluationOptions().reorientation_settles
    assert msg.ExperimentOptions().return_fields is EvaluationOptions().return_fields
