"""The client's connection to an evaluator that is not what it seems."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from ros_processes import isolated_ros

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from std_srvs.srv import Trigger  # noqa: E402

from defgrasp_ros.client.connection import Connection  # noqa: E402
from defgrasp_ros.client.failures import EvaluatorGoneError  # noqa: E402
from defgrasp_ros.ros.topics import STATUS, qos_profile  # noqa: E402

pytestmark = pytest.mark.timeout(60)


@pytest.fixture
def connection() -> Iterator[Connection]:
    with isolated_ros():
        connection = Connection("/evaluator", "client")
        yield connection
        connection.close()


def test_nobody_waits_for_ever_for_a_service(connection: Connection) -> None:
    """Without an evaluator it is gone; beside one that lacks the service, the time limit holds."""
    with pytest.raises(EvaluatorGoneError, match="/evaluator/stop"):
        connection.ask(Trigger, "stop", Trigger.Request(), None)
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("evaluator", context=context)
    node.create_publisher(STATUS.message_class, STATUS.name, qos_profile(STATUS))
    while not connection._node.count_publishers("/evaluator/status"):
        time.sleep(0.02)
    with pytest.raises(TimeoutError, match="/evaluator/stop.*after 0.1 s"):
        connection.ask(Trigger, "stop", Trigger.Request(), 0.1)
    node.destroy_node()
    rclpy.shutdown(context=context)
