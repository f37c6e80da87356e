"""Requests: domain objects to messages (the client's side) and back, with every check (the evaluator's side)."""

from __future__ import annotations

import array
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from defgrasp_interfaces import msg
from shape_msgs.msg import MeshTriangle

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMeshError, MeshTooLargeError, UnknownFrameError
from defgrasp_ros.evaluation import EvaluationOptions, in_order
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper_urdf import OBJECT_LINK
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.mesh_files import prepare_bytes, prepare_file
from defgrasp_ros.mesh.mesh_uri import path_of_uri
from defgrasp_ros.mesh.object_mesh import PreparedMesh, prepare_surface, prepare_tetrahedra
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.ros.fields import extract, fill, flat, point_message, rows
from defgrasp_ros.ros.object_registry import OBJECT_SCHEME, ObjectRegistry
from defgrasp_ros.ros.object_source import MeshData, MeshFile, ObjectSource, RegisteredObject, Surface

OBJECT_FRAME = OBJECT_LINK
"""Name of the object frame in message headers."""


# Material


def material_to_message(material: Material) -> msg.Material:
    """Return the message of a material."""
    return fill(msg.Material(), material)


def material_from_message(message: msg.Material) -> Material:
    """Return the material of a message.

    Raises:
        InvalidMaterialError: If a value is outside its physical range.
    """
    return extract(Material, message)


# Grasps


def grasp_to_message(grasp: Grasp) -> msg.Grasp:
    """Return the message of a grasp, in the object frame."""
    message = msg.Grasp(id=grasp.id, target_force=grasp.target_force or 0.0)
    message.pose.header.frame_id = OBJECT_FRAME
    message.pose.pose.position = point_message(grasp.position)
    orientation = message.pose.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = map(float, grasp.orientation)
    return message


def grasp_from_message(message: msg.Grasp) -> Grasp:
    """Return the grasp of a message.

    Raises:
        UnknownFrameError: If the pose is not given in the object frame.
        InvalidGraspError: If a number of the pose, or the target force, has no meaning.
    """
    frame = message.pose.header.frame_id
    if frame not in ("", OBJECT_FRAME):
        raise UnknownFrameError(
            f"grasp '{message.id}': pose.header.frame_id = '{frame}' is not known; give the pose in '{OBJECT_FRAME}', "
            "the frame of the mesh vertices"
        )
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    return Grasp(
        id=message.id,
        position=np.array([position.x, position.y, position.z]),
        orientation=np.array([orientation.x, orientation.y, orientation.z, orientation.w]),
        target_force=None if message.target_force == 0.0 else message.target_force,
    )


# Options


def options_to_message(options: EvaluationOptions) -> msg.ExperimentOptions:
    """Return the message of options; a number 0 means the evaluator's own value there."""
    message = fill(msg.ExperimentOptions(), options)
    message.experiments = in_order(options.experiments)
    return message


def options_from_message(message: msg.ExperimentOptions, defaults: EvaluationOptions) -> EvaluationOptions:
    """Return the options of a message, with ``defaults`` where a number is 0, and where no experiment is named.

    A bool of a message cannot be left out: states settle where both message and ``defaults`` say so.

    Raises:
        InvalidOptionsError: If a value is outside its range.
    """
    given = {field.name: getattr(message, field.name) for field in dataclasses.fields(EvaluationOptions)}
    named = {name: value for name, value in given.items() if isinstance(value, bool) or value}
    named["reorientation_settles"] = message.reorientation_settles and defaults.reorientation_settles
    return dataclasses.replace(defaults, **named)


# Object


def object_to_message(source: ObjectSource, material: Material, name: str = "") -> msg.ObjectModel:
    """Return the message of an object.

    Args:
        source: Its shape.
        material: Its material.
        name: Its name in status and logs; empty: that of a registered object.
    """
    message = msg.ObjectModel(name=name, material=material_to_message(material))
    match source:
        case MeshFile():
            message.uri = Path(source.path).absolute().as_uri()
            message.scale = float(source.scale)
        case MeshData():
            message.data = flat(np.frombuffer(source.data, dtype=np.uint8), "B")
            message.format = source.format
            message.scale = float(source.scale)
        case Surface():
            triangles = np.asarray(source.triangles, dtype=np.uint32)
            message.surface.vertices = [point_message(vertex) for vertex in source.vertices]
            message.surface.triangles = [MeshTriangle(vertex_indices=triangle) for triangle in triangles]
        case RegisteredObject():
            message.uri = OBJECT_SCHEME + source.name
            message.name = name or source.name
        case TetMesh():
            message.tetrahedra.vertices = flat(source.corners)
            message.tetrahedra.tetrahedra = flat(source.tetrahedra, "I")
        case _:
            kind = type(source).__name__
            raise TypeError(
                f"the shape of an object is a MeshFile, MeshData, Surface, TetMesh or RegisteredObject, not {kind}"
            )
    message.element_order = source.element_order or 0
    if isinstance(source, MeshFile | MeshData | Surface):
        message.target_edge_length = float(source.target_edge_length or 0.0)
    return message


def object_from_message(
    message: msg.ObjectModel,
    max_tetrahedra: int,
    mesh_directories: Sequence[Path] = (),
    registry: ObjectRegistry | None = None,
) -> ObjectModel:
    """Return the object of a message; a surface is filled with tetrahedra.

    Args:
        message: The object's message.
        max_tetrahedra: Largest number of tetrahedra that is accepted [-].
        mesh_directories: Folders from which files may be read; empty: all.
        registry: Objects known by name; None: those of the library alone.

    Raises:
        InvalidMaterialError: If a material value is outside its physical range.
        InvalidMeshError: If the shape is not given in exactly one way, cannot be read, or is no solid that can be
            simulated.
        NotFoundError: If the mesh file or the named object does not exist.
    """
    material = material_from_message(message.material)
    mesh = prepared_from_message(message, max_tetrahedra, mesh_directories, registry or ObjectRegistry()).logged()
    return ObjectModel(message.name, mesh, material)


def prepared_from_message(
    message: msg.ObjectModel, max_tetrahedra: int, mesh_directories: Sequence[Path], registry: ObjectRegistry
) -> PreparedMesh:
    """Return the shape of a message and what was mended on the way; arguments and errors as ``object_from_message``."""
    prepared = _prepared(message, mesh_directories, registry)
    count = len(prepared.mesh.tetrahedra)
    if count > max_tetrahedra:
        raise MeshTooLargeError(
            f"the object has {count} tetrahedra, more than max_tetrahedra = {max_tetrahedra}; "
            "give a larger object.target_edge_length or a coarser mesh"
        )
    return prepared


def _prepared(message: msg.ObjectModel, mesh_directories: Sequence[Path], registry: ObjectRegistry) -> PreparedMesh:
    shapes = {
        "uri": message.uri,
        "data": message.data,
        "surface": message.surface.vertices or message.surface.triangles,
        "tetrahedra": message.tetrahedra.vertices or message.tetrahedra.tetrahedra,
    }
    given = [name for name, shape in shapes.items() if len(shape)]
    if len(given) != 1:
        raise InvalidMeshError(
            f"the object's shape is given by {' and '.join(given) or 'nothing'}; "
            "give exactly one of object.uri, object.data, object.surface and object.tetrahedra"
        )
    scale = require_in_range(InvalidMeshError, "object.scale", message.scale, 0.0) or 1.0
    size = require_in_range(InvalidMeshError, "object.target_edge_length", message.target_edge_length, 0.0, unit="m")
    order = message.element_order or None
    options = {"scale": scale, "target_edge_length": size or None, "element_order": order}
    try:
        match given[0]:
            case "uri" if message.uri.startswith(OBJECT_SCHEME):
                return registry.prepared(message.uri.removeprefix(OBJECT_SCHEME), order)
            case "uri":
                return prepare_file(path_of_uri(message.uri, mesh_directories), **options)
            case "data":
                return prepare_bytes(bytes(message.data), message.format, **options)
            case "surface":
                points = [[point.x, point.y, point.z] for point in message.surface.vertices]
                corners = [triangle.vertex_indices for triangle in message.surface.triangles]
                vertices, triangles = np.array(points).reshape(-1, 3), np.array(corners, dtype=np.int64).reshape(-1, 3)
                return prepare_surface(vertices, triangles, **options)
            case _:
                vertices = _rows_of("vertices", message.tetrahedra.vertices, 3)
                tetrahedra = _rows_of("tetrahedra", message.tetrahedra.tetrahedra, 4)
                return prepare_tetrahedra(vertices, tetrahedra.astype(np.int64), scale=scale, element_order=order)
    except InvalidMeshError as error:
        raise type(error)(f"object.{given[0]}: {error}") from error


def _rows_of(name: str, values: array.array, width: int) -> np.ndarray:
    if len(values) % width:
        raise InvalidMeshError(f"{name} has {len(values)} numbers, which is no multiple of {width}")
    return rows(values, width)
