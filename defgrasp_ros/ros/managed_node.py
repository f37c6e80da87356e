"""A lifecycle node that starts itself if wanted, and that no wrong transition can end."""

from __future__ import annotations

import traceback
from collections.abc import Callable

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from defgrasp_ros.errors import DefgraspError

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNode):
    """Base of a node with work in its transitions: override ``configure``, ``activate``, ``deactivate``, ``cleanup``.

    What ``configure`` raises is logged and kept in ``problem``; the node then stays unconfigured.

    Args:
        name: Of the node.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.problem: str | None = None
        """Why the node cannot be configured; empty where it is, None where that was not tried yet."""
        self._service_change_state.callback = self._answered(self._service_change_state.callback)

    def start_by_itself(self) -> None:
        """Configure and activate as soon as the node spins."""
        # In the callback group of the lifecycle services, so that no other transition comes in between.
        self._start_timer = self.create_timer(0.0, self._start)

    def configure(self) -> None:
        """Get everything that requests need."""

    def activate(self) -> None:
        """Take requests."""

    def deactivate(self, reason: str) -> None:
        """Take no more requests, and end those that are there."""

    def cleanup(self) -> None:
        """Forget everything."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.configure()
        except Exception as error:  # rclpy would swallow it
            self.problem = str(error)
            details = "" if isinstance(error, DefgraspError) else f"\n{traceback.format_exc()}"
            self.get_logger().error(f"cannot be configured: {error}{details}")
            return FAILURE
        self.problem = ""
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.activate()
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.deactivate("the evaluator was deactivated")
        return SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.problem = None
        self.cleanup()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.deactivate("the evaluator was shut down")
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Back to unconfigured after a transition that raised."""
        self.deactivate("the evaluator failed in a transition")
        return SUCCESS

    def _start(self) -> None:
        self._start_timer.cancel()
        if self.trigger_configure() == SUCCESS:
            self.trigger_activate()
        else:
            self.deactivate(f"the evaluator is not active: {self.problem}")

    def _answered(self, change_state: Callable) -> Callable:
        """Return the callback with an impossible transition as an answer; rclpy lets it end the node."""

        def answer(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change_state(request, response)
            except RuntimeError as error:
                self.get_logger().warning(f"transition refused: {error}")
                response.success = False
                return response

        return answer
