"""The client of an evaluator: plain calls, data classes and NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any

from defgrasp_interfaces.action import EvaluateGrasps
from defgrasp_interfaces.msg import EvaluationRequest, EvaluatorStatus, ExperimentOptions
from defgrasp_interfaces.srv import (
    EvaluateGrasp,
    GetEvaluatorInfo,
    ListObjects,
    RegisterObject,
    RemoveObject,
    SampleGrasps,
)
from std_srvs.srv import Trigger

from defgrasp_ros.client.answer import EvaluationAnswer, EvaluationProgress
from defgrasp_ros.client.connection import Connection
from defgrasp_ros.client.failures import refusal
from defgrasp_ros.client.goal import EvaluationGoal, GoalReports
from defgrasp_ros.errors import IncorrectStateError, ResourceExhaustedError, ResultCode
from defgrasp_ros.evaluation import EvaluationOptions, GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.ros.object_source import ObjectSource
from defgrasp_ros.ros.request_conversion import (
    grasp_from_message,
    grasp_to_message,
    object_to_message,
    options_to_message,
)

DEFAULT_EVALUATOR = "/defgrasp_evaluator"

READY_TIMEOUT = 10.0
"""How long a call waits for an evaluator that is not there yet [s]."""


class GraspEvaluatorClient:
    """A connection to one evaluator; close it, or use it in a ``with`` statement. May be used from several threads.

    Args:
        evaluator: Full name of the evaluator's node.
        node_name: Name of the client's own node.
    """

    def __init__(self, evaluator: str = DEFAULT_EVALUATOR, node_name: str = "grasp_evaluator_client") -> None:
        self._evaluator = evaluator
        self._node_name = node_name
        self._lock = Lock()
        self._connection = Connection(evaluator, node_name)

    def wait_until_ready(self, timeout: float = READY_TIMEOUT) -> None:
        """Wait until the evaluator is there; every call does so, too.

        Args:
            timeout: Longest time to wait [s].

        Raises:
            EvaluatorGoneError: If it does not appear in time.
        """
        self._connected(timeout)

    def evaluate_grasps(
        self,
        source: ObjectSource,
        material: Material,
        grasps: Sequence[Grasp],
        *,
        timeout: float | None = None,
        **more: Any,
    ) -> EvaluationAnswer:
        """Simulate the experiments of the options with each grasp, and return when all are evaluated.

        A grasp that fails is no exception: its evaluation has the code and the reason.

        Args:
            source: Shape of the object: ``MeshFile``, ``MeshData``, ``Surface``, ``TetMesh`` or
                ``RegisteredObject``.
            material: Its material.
            grasps: Candidates, in the object frame.
            timeout: Longest time to wait for the answer [s]; None: as long as the evaluator is there. See
                ``time_limit`` for one that leaves you what is finished.
            more: As for ``start_evaluation``.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up; the evaluation is canceled.
            DefgraspError: If the request is refused: the class of ``defgrasp_ros.errors`` with the evaluator's code.
        """
        goal = self.start_evaluation(source, material, grasps, **more)
        try:
            return goal.answer(timeout)
        except (TimeoutError, KeyboardInterrupt):
            goal.cancel()
            raise

    def start_evaluation(
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
        time_limit: float = 0.0,
        on_progress: Callable[[EvaluationProgress], None] | None = None,
        on_evaluation: Callable[[GraspEvaluation], None] | None = None,
    ) -> EvaluationGoal:
        """Send grasps to the evaluator, and return when it has taken them into its queue.

        Args:
            source: Shape of the object, as for ``evaluate_grasps``.
            material: Its material.
            grasps: Candidates, in the object frame.
            object_name: Name of the object in status and logs.
            gripper: Name of a gripper; empty: the evaluator's.
            options: Experiments and constants of the protocol; None: the evaluator's.
            return_fields: Whether the answer carries nodal positions and element stresses; so do ``options``.
            record: Whether the run is logged.
            time_limit: Wall time after which the run ends with what is finished, the rest TIMEOUT [s]; 0: none.
                Waiting in the queue does not count.
            on_progress: Called a few times a second while the evaluator works, also on a goal of someone else that
                comes first.
            on_evaluation: Called with each evaluation as soon as it is there, without fields over the mesh.
                Both run in the client's thread: keep them short, and ask the evaluator for nothing in them.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            ResourceExhaustedError: If its queue is full.
            IncorrectStateError: If it is not active.
        """
        experiment = options_to_message(options) if options else ExperimentOptions()
        experiment.return_fields |= return_fields
        experiment.record = record
        request = EvaluationRequest(
            object=object_to_message(source, material, object_name),
            grasps=[grasp_to_message(grasp) for grasp in grasps],
            gripper=gripper,
            options=experiment,
            time_limit=float(time_limit),
        )
        connection = self._connected()
        reports = GoalReports(on_progress, on_evaluation)
        goal = EvaluateGrasps.Goal(request=request)
        accepted = connection.in_spinner(connection.action.send_goal_async, goal, reports.take)
        handle = connection.wait(accepted, connection.action_name, None)
        if not handle.accepted:
            raise self._rejection()
        return EvaluationGoal(connection, handle, reports)

    def call(self, request: EvaluationRequest, timeout: float | None = None) -> EvaluateGrasp.Response:
        """Send a request message to the service as it is, and return the answer as it comes, also a refusal.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up; the evaluator goes on.
        """
        return self._ask(EvaluateGrasp, "evaluate_grasp", EvaluateGrasp.Request(request=request), timeout)

    def stop(self, timeout: float | None = None) -> bool:
        """End what the evaluator evaluates at present, whoever asked for it; return whether there was something."""
        return self._ask(Trigger, "stop", Trigger.Request(), timeout).success

    def info(self, timeout: float | None = None) -> GetEvaluatorInfo.Response:
        """Return what the evaluator is, can do, and does now; it answers at once."""
        return self._ask(GetEvaluatorInfo, "get_evaluator_info", GetEvaluatorInfo.Request(), timeout)

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

    def close(self) -> None:
        """Leave the ROS graph."""
        self._connection.close()

    def __enter__(self) -> GraspEvaluatorClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accepted(self, kind: type, name: str, request: object, timeout: float | None) -> Any:
        """Call a service of the evaluator and return its answer; raise if it is a refusal."""
        response = self._ask(kind, name, request, timeout)
        if response.result.code != ResultCode.OK:
            raise refusal(response.result)
        return response

    def _ask(self, kind: type, name: str, request: object, timeout: float | None) -> Any:
        return self._connected().ask(kind, name, request, timeout)

    def _connected(self, timeout: float = READY_TIMEOUT) -> Connection:
        """Return the connection to a living evaluator; errors as of ``wait_until_ready``."""
        with self._lock:
            if self._connection.is_lost:
                self._connection.close()
                self._connection = Connection(self._evaluator, self._node_name)
            connection = self._connection
        connection.wait_until_ready(timeout)
        return connection

    def _rejection(self) -> IncorrectStateError | ResourceExhaustedError:
        """Return why a goal was rejected, which an action cannot say itself."""
        info = self.info(READY_TIMEOUT)
        if info.status.state == EvaluatorStatus.STATE_INACTIVE:
            return IncorrectStateError("the evaluator is not active; activate it with its lifecycle services")
        return ResourceExhaustedError(
            f"the evaluator's queue was full: max_queued_goals = {info.max_queued_goals}; ask again later"
        )
