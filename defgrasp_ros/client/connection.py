"""A client's own node, and how it waits for answers of an evaluator that may end at any moment."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from threading import Condition, Thread, current_thread
from typing import Any

import rclpy
from defgrasp_interfaces.action import EvaluateGrasps
from defgrasp_interfaces.msg import EvaluatorStatus
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.context import Context
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from defgrasp_ros.client.failures import EvaluatorGoneError
from defgrasp_ros.ros.topics import EVERY_FEEDBACK, STATUS, qos_profile

LOOK_INTERVAL = 1.0
"""How often somebody who waits looks whether the evaluator is still there [s]; an event usually says so before."""

LAST_ANSWER = 0.5
"""How long the last answer of an evaluator that ended may still be under way [s]."""

SEEN_INTERVAL = 0.02
"""How often somebody who waits for the evaluator to appear looks [s]."""


class Connection:
    """A node with a thread that spins it, and one evaluator on the other side; not used again once that has ended.

    The evaluator's process vouches for its status topic; when it ceases to do so, whoever waits is told. The graph
    shows a dead process for much longer, which is why a new evaluator gets a new connection.

    Args:
        evaluator: Full name of the evaluator's node.
        node_name: Name of the client's own node.
    """

    def __init__(self, evaluator: str, node_name: str) -> None:
        self.evaluator = evaluator
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(node_name, context=self._context)
        self._changed = Condition()
        self._is_lost = False
        self._status_topic = STATUS.name.replace("~", evaluator)
        self._node.create_subscription(
            EvaluatorStatus,
            self._status_topic,
            lambda _: None,
            qos_profile(STATUS),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._note_liveliness),
        )
        self.action_name = f"{evaluator}/evaluate_grasps"
        self.action = ActionClient(
            self._node, EvaluateGrasps, self.action_name, feedback_sub_qos_profile=EVERY_FEEDBACK
        )
        self._services: dict[str, Client] = {}
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._spinner = Thread(target=self._executor.spin, name=node_name, daemon=True)
        self._spinner.start()

    @property
    def is_lost(self) -> bool:
        """Whether the evaluator was there and has ended."""
        return self._is_lost

    def wait_until_ready(self, timeout: float) -> None:
        """Wait until the evaluator is there.

        Args:
            timeout: Longest time to wait [s].

        Raises:
            EvaluatorGoneError: If it does not appear in time.
        """
        deadline = time.monotonic() + timeout
        while not (self._is_there() and self.action.server_is_ready()):
            if time.monotonic() >= deadline:
                raise EvaluatorGoneError(
                    f"no evaluator at {self.evaluator} after {timeout:g} s; start it with 'ros2 run defgrasp_ros "
                    f"defgrasp_evaluator', with this ROS_DOMAIN_ID ({self._context.get_domain_id()})"
                )
            time.sleep(SEEN_INTERVAL)

    def ask(self, kind: type, name: str, request: object, timeout: float | None) -> Any:
        """Call a service of the evaluator and return its answer.

        Args:
            kind: Class of the service.
            name: Its name, relative to the evaluator.
            request: Of that class.
            timeout: Longest time to wait for the answer [s]; None: as long as the evaluator is there.

        Raises:
            EvaluatorGoneError: If the evaluator ends before it answers.
            TimeoutError: If the time is up.
        """
        deadline = time.monotonic() + (math.inf if timeout is None else timeout)
        with self._changed:
            service = self._services.get(name)
            if service is None:
                service = self._services[name] = self._node.create_client(kind, f"{self.evaluator}/{name}")
        while not service.wait_for_service(max(0.0, min(LOOK_INTERVAL, deadline - time.monotonic()))):
            # It is discovered a moment after the action.
            if self._is_lost or not self._is_there():
                raise EvaluatorGoneError(f"{service.srv_name}: the evaluator has ended")
            if time.monotonic() >= deadline:
                raise TimeoutError(f"{service.srv_name}: the service is not there after {timeout:g} s")
        future = service.call_async(request)
        try:
            return self.wait(future, service.srv_name, timeout)
        except BaseException:
            service.remove_pending_request(future)
            raise

    def in_spinner(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a call returns that is done by the thread which takes the answers.

        rclpy's action client loses an answer that is there before the call which asked for it has returned.

        Raises:
            EvaluatorGoneError: If the evaluator has ended.
        """
        if current_thread() is self._spinner:
            return call(*arguments)
        return self.wait(self._executor.create_task(call, *arguments), self.action_name, None)

    def wait(self, future: Future, what: str, timeout: float | None) -> Any:
        """Wait for the result of a future.

        Args:
            future: Gets its result from the evaluator.
            what: What is waited for, in the text of errors.
            timeout: Longest time to wait [s]; None: as long as the evaluator is there.

        Raises:
            EvaluatorGoneError: If the evaluator ends before.
            TimeoutError: If the time is up.
        """
        future.add_done_callback(lambda _: self._notify())
        deadline = time.monotonic() + (math.inf if timeout is None else timeout)
        is_ending = False
        with self._changed:
            while not future.done():
                left = deadline - time.monotonic()
                if left <= 0.0:
                    if is_ending:
                        raise EvaluatorGoneError(f"{what}: the evaluator ended before it answered")
                    raise TimeoutError(f"{what}: no answer after {timeout:g} s")
                if not is_ending and (self._is_lost or not self._is_there()):
                    is_ending = self._is_lost = True
                    deadline = min(deadline, time.monotonic() + LAST_ANSWER)
                else:
                    self._changed.wait(min(LOOK_INTERVAL, left))
        return future.result()

    def close(self) -> None:
        """Leave the ROS graph."""
        self._executor.shutdown()
        self._spinner.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _is_there(self) -> bool:
        return self._node.count_publishers(self._status_topic) > 0

    def _note_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        if event.alive_count_change < 0:
            with self._changed:
                self._is_lost = True
                self._changed.notify_all()

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()
