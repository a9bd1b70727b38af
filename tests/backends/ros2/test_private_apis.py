"""What we use of rclpy beyond its public API: see `tests/test_private_apis.py`."""

from __future__ import annotations

from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from std_srvs.srv import Trigger

_BOUND = 60.0  # s


class Pending:
    """Has what an executor calls, and nothing else of a future."""

    def __init__(self) -> None:
        self.executor: object = None
        self.response: Any = None

    def _set_executor(self, executor: object) -> None:
        self.executor = executor

    def set_result(self, response: Any) -> None:
        self.response = response


@pytest.mark.parametrize("made", [EventsExecutor, SingleThreadedExecutor])
def test_an_executor_gives_a_response_to_what_the_client_says_is_pending(made: Any) -> None:
    """For rcp_ros2/service_client.py."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("private_apis", context=context)
    executor = made(context=context)
    try:
        executor.add_node(node)
        node.create_service(Trigger, "private_apis", _answer)
        client: Any = node.create_client(Trigger, "private_apis")
        assert client.wait_for_service(_BOUND)
        pending: dict[int, Pending] = {}
        client.get_pending_request = pending.pop
        with client.handle:
            number = client.handle.send_request(Trigger.Request())
        sent = pending[number] = Pending()
        clock = node.get_clock()
        end = clock.now().nanoseconds + int(_BOUND * 1e9)
        while sent.response is None and clock.now().nanoseconds < end:
            executor.spin_once(timeout_sec=1.0)
        response: Any = sent.response
        assert response.message == "done"
        assert sent.executor is executor
        assert not pending
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def _answer(_request: Any, response: Any) -> Any:
    response.message = "done"
    return response
