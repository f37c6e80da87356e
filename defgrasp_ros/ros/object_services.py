"""The services around objects: register, list, remove, and sample grasps for them."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from threading import Event
from typing import TypeVar

from defgrasp_interfaces import msg, srv
from geometry_msgs.msg import Point, Vector3
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from defgrasp_ros.errors import DefgraspError, ResultCode
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.mesh.limited_process import interruptible
from defgrasp_ros.mesh.report import mesh_report
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.objects import object_library
from defgrasp_ros.ros.object_registry import ObjectRegistry
from defgrasp_ros.ros.parameters import experiment_defaults, mesh_directories, parameter_values
from defgrasp_ros.ros.request_conversion import grasp_to_message, material_from_message, prepared_from_message
from defgrasp_ros.sampling import sample_grasps
from defgrasp_ros.sampling.antipodal import DEFAULT_CONE
from defgrasp_ros.sampling.detail import with_fewer_triangles
from defgrasp_ros.sampling.sampler import ANTIPODAL

DEFAULT_COUNT = 50
"""Grasps sampled where a request gives 0."""

Response = TypeVar("Response")


class ObjectServices:
    """Answers requests about objects, one after the other, while the node evaluates grasps.

    Args:
        node: Offers the services.
        registry: The objects.
    """

    def __init__(self, node: Node, registry: ObjectRegistry) -> None:
        self._node = node
        self._registry = registry
        self._stopped = Event()
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, answer in (
            (srv.RegisterObject, "~/register_object", self._register),
            (srv.ListObjects, "~/list_objects", self._list),
            (srv.RemoveObject, "~/remove_object", self._remove),
            (srv.SampleGrasps, "~/sample_grasps", self._sample),
        ):
            node.create_service(kind, name, self._guarded(answer), callback_group=group)

    def stop(self) -> None:
        """End the mesh work that is under way, and let none begin; the callers get CANCELED."""
        self._stopped.set()

    def _guarded(self, answer: Callable) -> Callable:
        """Return the answer with every failure as a result with its code."""

        def answered(request: object, response: Response) -> Response:
            try:
                with interruptible(self._stopped.is_set):
                    answer(request, response)
            except DefgraspError as error:
                response.result = msg.Result(code=error.code, message=str(error))
            except Exception as error:
                self._node.get_logger().error(traceback.format_exc())
                text = f"{type(error).__name__}: {error}"
                response.result = msg.Result(code=ResultCode.OPERATION_FAILED, message=text)
            return response

        return answered

    def _register(self, request: srv.RegisterObject.Request, response: srv.RegisterObject.Response) -> None:
        name = request.object_id or request.object.name
        self._registry.check_name(name, replace=request.replace)
        parameters = parameter_values(self._node)
        material = material_from_message(request.object.material)
        prepared = prepared_from_message(
            request.object, parameters["max_tetrahedra"], mesh_directories(parameters), self._registry
        )
        report = mesh_report(name, prepared, material)
        self._registry.add(name, prepared.mesh)
        model = ObjectModel(name, prepared.mesh, material)
        factor = experiment_defaults(parameters).force_safety_factor
        response.result = msg.Result(code=ResultCode.OK)
        response.object_id = name
        response.vertex_count, response.tetrahedron_count = report.nodes, report.tetrahedra
        response.element_order = report.element_order
        response.volume, response.mass = report.volume, report.mass
        x, y, z = map(float, report.center_of_mass)
        response.center_of_mass = Point(x=x, y=y, z=z)
        x, y, z = map(float, report.extents)
        response.extents = Vector3(x=x, y=y, z=z)
        response.min_dihedral_angle = report.min_dihedral_angle
        response.default_target_force = model.default_target_force(factor)
        response.mends, response.warnings = list(report.mends), list(report.warnings)
        self._node.get_logger().info(f"registered object '{name}': {report.nodes} nodes, {1e3 * report.mass:.1f} g")

    def _list(self, _: srv.ListObjects.Request, response: srv.ListObjects.Response) -> None:
        response.result = msg.Result(code=ResultCode.OK)
        response.object_ids = self._registry.names()
        response.library = list(object_library())

    def _remove(self, request: srv.RemoveObject.Request, response: srv.RemoveObject.Response) -> None:
        self._registry.remove(request.object_id)
        response.result = msg.Result(code=ResultCode.OK)

    def _sample(self, request: srv.SampleGrasps.Request, response: srv.SampleGrasps.Response) -> None:
        surface = with_fewer_triangles(*self._registry.surface(request.object_id))
        gripper = load_gripper(request.gripper or self._node.get_parameter("gripper").value)
        count = request.count or DEFAULT_COUNT
        grasps = sample_grasps(
            *surface,
            gripper,
            count,
            sampler=request.sampler or ANTIPODAL,
            max_angle=request.max_angle or DEFAULT_CONE,
            standoff=request.standoff,
            seed=request.seed,
        )
        response.grasps = [grasp_to_message(grasp) for grasp in grasps]
        text = f"{len(grasps)} of {count} grasps were found" if len(grasps) < count else ""
        response.result = msg.Result(code=ResultCode.OK, message=text)
