"""A client's own node, and how it waits for answers of an evaluator that may end at any moment."""

from __future__ import annotations

import math
import time
from threading import Condition, Thread
from typing import Any

import rclpy
from defgrasp_interfaces.msg import EvaluatorStatus
from rclpy.client import Client
from rclpy.context import Context
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from defgrasp_ros.client.failures import EvaluatorGoneError
from defgrasp_ros.ros.topics import STATUS, qos_profile

LOOK_INTERVAL = 1.0
"""How often somebody who waits looks whether the evaluator is still there [s]; an event usually says so before."""

LAST_ANSWER = 0.5
"""How long the last answer of an evaluator that ended may still be under way [s]."""

SEEN_INTERVAL = 0.02
"""How often somebody who waits for the evaluator to appear looks [s]."""


class Connection:
    """A node with a thread that spins it, and the evaluator on the other side.

    The evaluator's process vouches for its status topic; when it stops to do so, whoever waits is told.

    Args:
        evaluator: Full name of the evaluator's node.
        node_name: Name of the client's own node.
    """

    def __init__(self, evaluator: str, node_name: str) -> None:
        self.evaluator = evaluator
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(node_name, context=self._context)
        self._changed = Condition()
        self._losses = 0
        self._clients: dict[str, Client] = {}
        self.node.create_subscription(
            EvaluatorStatus,
            STATUS.name.replace("~", evaluator),
            lambda _: None,
            qos_profile(STATUS),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._note_liveliness),
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._spinner = Thread(target=self._executor.spin, name=node_name, daemon=True)
        self._spinner.start()

    def gone(self, what: str) -> EvaluatorGoneError:
        """Return the error that there is no evaluator."""
        return EvaluatorGoneError(
            f"{what}; start an evaluator with 'ros2 run defgrasp_ros defgrasp_evaluator', "
            f"with this ROS_DOMAIN_ID ({self._context.get_domain_id()})"
        )

    def wait_until_seen(self, timeout: float) -> bool:
        """Wait until the evaluator's status topic is there [s]; return whether it is."""
        deadline = time.monotonic() + timeout
        while not self._is_there():
            if time.monotonic() >= deadline:
                return False
            time.sleep(SEEN_INTERVAL)
        return True

    def client(self, kind: type, name: str) -> Client:
        """Return the client of a service of the evaluator."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"{self.evaluator}/{name}")
        return self._clients[name]

    def ask(self, service: Client, request: object, timeout: float | None) -> Any:
        """Call a service and return its answer.

        Raises:
            EvaluatorGoneError: If no evaluator is there, or it ends before it answers.
            TimeoutError: If the time is up.
        """
        mark = self.mark()
        future = service.call_async(request)
        try:
            return self.wait(future, service.srv_name, timeout, mark)
        except BaseException:
            service.remove_pending_request(future)
            raise

    def mark(self) -> int:
        """Return a mark of this moment; ``wait`` notices an evaluator that ends after it."""
        return self._losses

    def wait(self, future: Future, what: str, timeout: float | None, mark: int) -> Any:
        """Wait for the result of a future.

        Args:
            future: Gets its result from the evaluator.
            what: What is waited for, in the text of errors.
            timeout: Longest time to wait [s]; None: as long as the evaluator is there.
            mark: Of the moment before the evaluator was asked.

        Raises:
            EvaluatorGoneError: If the evaluator ends before.
            TimeoutError: If the time is up.
        """
        future.add_done_callback(lambda _: self._notify())
        deadline = time.monotonic() + (math.inf if timeout is None else timeout)
        with self._changed:
            is_gone = False
            while not future.done():
                left = deadline - time.monotonic()
                if left <= 0.0:
                    if is_gone:
                        raise EvaluatorGoneError(f"{what}: the evaluator ended before it answered")
                    raise TimeoutError(f"{what}: no answer after {timeout:g} s")
                if not is_gone and (self._losses != mark or not self._is_there()):
                    is_gone = True
                    deadline = min(deadline, time.monotonic() + LAST_ANSWER)
                else:
                    self._changed.wait(min(LOOK_INTERVAL, left))
        return future.result()

    def close(self) -> None:
        """Leave the ROS graph."""
        self._executor.shutdown()
        self._spinner.join()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _is_there(self) -> bool:
        return self.node.count_publishers(STATUS.name.replace("~", self.evaluator)) > 0

    def _note_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        if event.alive_count_change < 0:
            with self._changed:
                self._losses += 1
                self._changed.notify_all()

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()
