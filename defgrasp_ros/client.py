"""Asks a running evaluator what candidate grasps are worth.

Example::

    with GraspEvaluatorClient() as client:
        answer = client.evaluate_grasps(MeshFile("banana.stl"), Material(youngs_modulus=1e5), grasps)
    for evaluation in answer.evaluations:
        print(evaluation.grasp_id, evaluation.code.name, evaluation.metrics.max_von_mises_stress)

Needs ROS 2 and the interface package ``defgrasp_interfaces``, but neither simulator nor GPU: it runs wherever the
planner runs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any
from urllib.parse import unquote, urlsplit

import rclpy
from defgrasp_interfaces.msg import EvaluationRequest, EvaluatorStatus, ExperimentOptions, Result
from defgrasp_interfaces.srv import EvaluateGrasp, ListObjects, RegisterObject, RemoveObject, SampleGrasps
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from defgrasp_ros.errors import DefgraspError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation, Phase, Progress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.ros.object_source import MeshData, MeshFile, ObjectSource, RegisteredObject, Surface
from defgrasp_ros.ros.request_conversion import (
    grasp_from_message,
    grasp_to_message,
    object_to_message,
    options_to_message,
)
from defgrasp_ros.ros.result_conversion import evaluation_from_message
from defgrasp_ros.ros.topics import STATUS, qos_profile

__all__ = [
    "EvaluationAnswer",
    "EvaluatorGoneError",
    "GraspEvaluatorClient",
    "MeshData",
    "MeshFile",
    "RegisteredObject",
    "Surface",
]

DEFAULT_EVALUATOR = "/defgrasp_evaluator"

LIVELINESS_INTERVAL = 1.0
"""How often a waiting client looks whether the evaluator is still there [s]."""


class EvaluatorGoneError(DefgraspError):
    """No evaluator is running, or it ended before it answered."""


@dataclass(frozen=True)
class EvaluationAnswer:
    """What the evaluator answered."""

    evaluations: list[GraspEvaluation]
    """One per grasp, in the order of the request."""
    code: ResultCode
    """OK, or CANCELED where the evaluator was stopped: evaluations that were not finished then have that code, too."""
    message: str
    """Summary; also says if something went wrong beside the evaluation, e.g. the log."""
    log_path: Path | None
    """The run's log on the evaluator's machine; None if none was written."""


class GraspEvaluatorClient:
    """A connection to one evaluator; close it, or use it in a ``with`` statement.

    Args:
        evaluator: Full name of the evaluator's node.
        node_name: Name of the client's own node.
    """

    def __init__(self, evaluator: str = DEFAULT_EVALUATOR, node_name: str = "grasp_evaluator_client") -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(node_name, context=self._context)
        self._evaluator = evaluator
        self._clients: dict[str, Client] = {}
        self._service = self._node.create_client(EvaluateGrasp, f"{evaluator}/evaluate_grasp")
        self._on_progress: Callable[[Progress], None] | None = None
        status_topic = STATUS.name.replace("~", evaluator)
        self._node.create_subscription(EvaluatorStatus, status_topic, self._follow, qos_profile(STATUS))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._spinner = Thread(target=self._executor.spin, name=node_name, daemon=True)
        self._spinner.start()

    def wait_until_ready(self, timeout: float = 10.0) -> None:
        """Wait until the evaluator is there.

        Args:
            timeout: Longest time to wait [s].

        Raises:
            EvaluatorGoneError: If it does not appear in time.
        """
        if not self._service.wait_for_service(timeout_sec=timeout):
            raise EvaluatorGoneError(
                f"no evaluator at {self._service.srv_name} after {timeout:g} s; start it with "
                f"'ros2 run defgrasp_ros defgrasp_evaluator', with this ROS_DOMAIN_ID ({self._context.get_domain_id()})"
            )

    def evaluate_grasps(
        self,
        source: ObjectSource,
        material: Material,
        grasps: Sequence[Grasp],
        *,
        object_name: str = "",
        gripper: str = "",
        options: EvaluationOptions | None = None,
        return_fields: bool = False,
        record: bool = True,
        on_progress: Callable[[Progress], None] | None = None,
        timeout: float | None = None,
    ) -> EvaluationAnswer:
        """Simulate the experiments of the options with each grasp, and return when all are evaluated.

        A grasp that fails is no exception: its evaluation has the code and the reason.

        Args:
            source: Shape of the object: ``MeshFile``, ``MeshData``, ``Surface``, ``TetMesh`` or
                ``RegisteredObject``.
            material: Its material.
            grasps: Candidates, in the object frame.
            object_name: Name of the object in status and logs.
            gripper: Name of a gripper; empty: the evaluator's.
            options: Experiments and constants of the protocol; None: the evaluator's.
            return_fields: Whether the answer carries nodal positions and element stresses; so do ``options``.
            record: Whether the run is logged.
            on_progress: Called while the evaluator works, also on a request of someone else that comes first; runs
                in the client's thread, so keep it short.
            timeout: Longest time to wait for the answer [s]; None: as long as the evaluator is there.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up; the evaluator goes on.
            DefgraspError: If the request is refused: the class of ``defgrasp_ros.errors`` with the evaluator's code.
        """
        experiment = options_to_message(options) if options else ExperimentOptions()
        experiment.return_fields |= return_fields
        experiment.record = record
        request = EvaluationRequest(
            object=object_to_message(source, material, object_name),
            grasps=[grasp_to_message(grasp) for grasp in grasps],
            gripper=gripper,
            options=experiment,
        )
        self._on_progress = on_progress
        try:
            response = self.call(request, timeout)
        finally:
            self._on_progress = None
        if not response.evaluations:
            raise refusal(response.result)
        return EvaluationAnswer(
            evaluations=[evaluation_from_message(message) for message in response.evaluations],
            code=ResultCode(response.result.code),
            message=response.result.message,
            log_path=Path(unquote(urlsplit(response.log_uri).path)) if response.log_uri else None,
        )

    def call(self, request: EvaluationRequest, timeout: float | None = None) -> EvaluateGrasp.Response:
        """Send a request message as it is and return the evaluator's answer as it comes, also a refusal.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up.
        """
        return self._ask(self._service, EvaluateGrasp.Request(request=request), timeout)

    def register_object(
        self,
        source: ObjectSource,
        material: Material,
        name: str,
        *,
        replace: bool = False,
        timeout: float | None = None,
    ) -> RegisterObject.Response:
        """Let the evaluator read, mend and mesh an object once; requests then name it by ``RegisteredObject(name)``.

        Args:
            source: Shape of the object.
            material: Its material; gives mass and default target force of the answer.
            name: Name under which it is kept.
            replace: Whether an object of that name is replaced.
            timeout: Longest time to wait for the answer [s].

        Returns:
            Size, mass and quality of the mesh, what was mended and what may be wrong.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up.
            DefgraspError: If it is refused: the class of ``defgrasp_ros.errors`` with the evaluator's code.
        """
        message = object_to_message(source, material, name)
        request = RegisterObject.Request(object=message, object_id=name, replace=replace)
        return self._accepted(RegisterObject, "register_object", request, timeout)

    def list_objects(self, timeout: float | None = None) -> ListObjects.Response:
        """Return the names of the registered objects and of those of the library; errors as of ``register_object``."""
        return self._accepted(ListObjects, "list_objects", ListObjects.Request(), timeout)

    def remove_object(self, name: str, timeout: float | None = None) -> None:
        """Let the evaluator forget a registered object; errors as of ``register_object``."""
        self._accepted(RemoveObject, "remove_object", RemoveObject.Request(object_id=name), timeout)

    def sample_grasps(
        self,
        name: str,
        count: int = 50,
        *,
        gripper: str = "",
        sampler: str = "",
        max_angle: float = 0.0,
        standoff: float = 0.0,
        seed: int = 0,
        timeout: float | None = None,
    ) -> list[Grasp]:
        """Return candidate grasps for a registered object or one of the library.

        Args:
            name: Of the object.
            count: How many; fewer are returned where there are no more.
            gripper: Name of a gripper; empty: the evaluator's.
            sampler: antipodal, surface, uniform, grid or polar; empty: antipodal.
            max_angle: Antipodal: largest angle of contact normals and closing axis [rad]; 0: the evaluator's default.
            standoff: Antipodal: how far the grasp frame stays behind the middle of the contacts [m].
            seed: Equal seeds give equal grasps.
            timeout: Longest time to wait for the answer [s].

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up.
            DefgraspError: If there is no such object, or no grasp: the class of ``defgrasp_ros.errors``.
        """
        request = SampleGrasps.Request(
            object_id=name,
            count=count,
            gripper=gripper,
            sampler=sampler,
            max_angle=max_angle,
            standoff=standoff,
            seed=seed,
        )
        response = self._accepted(SampleGrasps, "sample_grasps", request, timeout)
        return [grasp_from_message(message) for message in response.grasps]

    def _accepted(self, kind: type, name: str, request: object, timeout: float | None) -> Any:
        """Call a service of the evaluator and return its answer; raise if it is a refusal."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, f"{self._evaluator}/{name}")
        response = self._ask(self._clients[name], request, timeout)
        if response.result.code != ResultCode.OK:
            raise refusal(response.result)
        return response

    def _ask(self, service: Client, request: object, timeout: float | None) -> Any:
        self.wait_until_ready()
        service.wait_for_service(LIVELINESS_INTERVAL)  # discovered a moment after the first one
        answered = Event()
        future = service.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        deadline = time.monotonic() + (math.inf if timeout is None else timeout)
        while not answered.wait(min(LIVELINESS_INTERVAL, max(0.0, deadline - time.monotonic()))):
            is_gone = not self._service.service_is_ready()
            if is_gone or time.monotonic() >= deadline:
                service.remove_pending_request(future)
                if is_gone:
                    raise EvaluatorGoneError(f"{service.srv_name}: the evaluator ended before it answered")
                raise TimeoutError(f"{service.srv_name}: no answer after {timeout:g} s")
        return future.result()

    def close(self) -> None:
        """Leave the ROS graph."""
        self._executor.shutdown()
        self._spinner.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    def __enter__(self) -> GraspEvaluatorClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _follow(self, status: EvaluatorStatus) -> None:
        on_progress = self._on_progress
        if on_progress and status.state != EvaluatorStatus.STATE_IDLE:
            on_progress(
                Progress(
                    phase=Phase(status.phase),
                    fraction=status.progress,
                    simulated_time=status.simulated_time,
                    active_grasps=status.active_grasps,
                    grasp_count=status.grasp_count,
                )
            )


def refusal(result: Result) -> DefgraspError:
    """Return the error that a result stands for, of the class whose code it has."""
    classes = {error.code: error for error in reversed(_with_subclasses(DefgraspError))}
    error = classes.get(result.code, DefgraspError)(result.message)
    error.code = ResultCode(result.code)  # also where no class has this code
    return error


def _with_subclasses(error: type[DefgraspError]) -> list[type[DefgraspError]]:
    return [error, *(each for subclass in error.__subclasses__() for each in _with_subclasses(subclass))]
