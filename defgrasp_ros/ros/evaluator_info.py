"""The service ``~/get_evaluator_info``: what the evaluator is, can do, and does now."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from defgrasp_interfaces.srv import GetEvaluatorInfo
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from defgrasp_ros import __version__
from defgrasp_ros.evaluation import Experiment
from defgrasp_ros.gripper import gripper_names
from defgrasp_ros.mesh.mesh_files import MESH_FORMATS
from defgrasp_ros.presets import preset_names
from defgrasp_ros.ros.object_registry import ObjectRegistry
from defgrasp_ros.ros.status_reporter import StatusReporter


class EvaluatorInfo:
    """Answers at once, whatever else goes on.

    Args:
        node: Offers the service.
        status: What it does now.
        registry: Its objects.
        devices: Tells the names of the devices of this machine; none are known before the first configuration.
    """

    def __init__(
        self, node: Node, status: StatusReporter, registry: ObjectRegistry, devices: Callable[[], Sequence[str]]
    ) -> None:
        self._node = node
        self._status = status
        self._registry = registry
        self._devices = devices
        self._fixed = {
            "version": __version__,
            "experiments": [str(experiment) for experiment in Experiment],
            "mesh_formats": list(MESH_FORMATS),
            "grippers": gripper_names(),
            "presets": preset_names(),
        }
        node.create_service(
            GetEvaluatorInfo,
            "~/get_evaluator_info",
            self._answer,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    def _answer(self, _: GetEvaluatorInfo.Request, response: GetEvaluatorInfo.Response) -> GetEvaluatorInfo.Response:
        for name, value in self._fixed.items():
            setattr(response, name, value)
        for name in ("device", "max_grasps", "max_tetrahedra", "max_queued_goals"):
            setattr(response, name, self._node.get_parameter(name).value)
        response.devices = list(self._devices())
        response.objects = self._registry.names()
        response.status = self._status.current()
        response.queued_goals = response.status.queued_goals
        return response
