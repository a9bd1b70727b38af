"""The façade for scripts, from a thread without an event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor

import pytest

from plugins.client.gateway import BOUND, OPERATOR, Gateway
from rcp_client import ConnectionLost, Robot
from rcp_kernel.errors import Cancelled, OutOfRange


class Running:
    """A gateway on a loop of its own, for tests that block."""

    def __init__(self) -> None:
        self.gateway = Gateway()
        self.loop = asyncio.new_event_loop()
        self.ready = threading.Event()
        self._stop = asyncio.Event()
        self.thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self.loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        async with self.gateway:
            self.ready.set()
            await self._stop.wait()

    def do(self, function: object, *args: object) -> None:
        self.loop.call_soon_threadsafe(function, *args)  # pyright: ignore[reportArgumentType]

    def stop(self) -> None:
        self.do(self._stop.set)
        self.thread.join(BOUND)


@pytest.fixture
def running() -> Generator[Running]:
    made = Running()
    made.thread.start()
    assert made.ready.wait(BOUND)
    yield made
    made.stop()


@pytest.fixture
def robot(running: Running) -> Generator[Robot]:
    with Robot(running.gateway.url, token=OPERATOR) as made:
        yield made


def test_every_request_waits_for_its_answer(running: Running, robot: Robot) -> None:
    assert robot.read("/param/limit") == 1.5
    assert robot.sample("/param/limit").path == "/tenant/alpha/param/limit"
    assert robot.write("/param/limit", 0.5) == 0.5
    values = {"/param/limit": 0.6, "/param/label": "box"}
    assert robot.write_all(values) == values
    assert len(robot.discover(kind="param")) == 2
    assert robot.status()["state"] == "ok"
    assert robot.ping() > 0
    assert robot.request({"type": "ping"}).status == "completed"
    assert [r.status for r in robot.batch([{"type": "ping"}])] == ["completed"]
    assert robot.commands() == []
    assert robot.estop()["active"]
    with pytest.raises(OutOfRange):
        robot.write("/param/limit", 9)


def test_a_subscription_is_a_loop(running: Running, robot: Robot) -> None:
    point = running.gateway.robot
    with robot.subscribe("/sensor/count", reliable=True, count=5) as updates:
        running.do(point.publish, 5)
        assert [update.body for update in updates] == [1, 2, 3, 4, 5]
    for update in robot.subscribe("/sensor/count"):
        assert update.body == 5
        break


def test_a_command_is_followed_or_cancelled(running: Running, robot: Robot) -> None:
    handle = robot.start("/action/go", {"x": 1.0})
    assert robot.cancel(handle.id or "") == [handle.id]
    with pytest.raises(Cancelled):
        handle.result()
    running.do(running.gateway.robot.release.set)
    assert robot.execute("/action/go", {"x": 2.0}) == {"x": 2.0, "y": 0.0}
    handle = robot.start("/action/go", {"x": 3.0})
    assert [item.status for item in handle][-1] == "in_progress"
    assert (handle.result(), handle.status) == ({"x": 3.0, "y": 0.0}, "completed")


def test_what_may_have_acted_is_not_to_be_repeated(running: Running) -> None:
    started = running.gateway.robot.started
    with ThreadPoolExecutor(2) as pool, Robot(running.gateway.url, token=OPERATOR) as robot:
        asked = [
            pool.submit(robot.execute, "/action/go", {"x": 1.0}, idempotency_key=key)
            for key in (None, "mine")
        ]
        for _ in asked:
            asyncio.run_coroutine_threadsafe(started.get(), running.loop).result(BOUND)
        robot.__exit__(None, None, None)
        lost = [one.exception(BOUND) for one in asked]
    assert all(isinstance(error, ConnectionLost) for error in lost)
    assert [error.retryable for error in lost if isinstance(error, ConnectionLost)] == [False, True]


def test_several_threads_may_ask_at_once(running: Running, robot: Robot) -> None:
    found: list[float] = []
    threads = [
        threading.Thread(target=lambda: found.append(robot.read("/param/limit"))) for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(BOUND)
    assert found == [1.5] * 8


def test_it_is_used_inside_its_block(running: Running) -> None:
    robot = Robot(running.gateway.url)
    with pytest.raises(RuntimeError, match="inside its `with` block"):
        robot.ping()


def test_nobody_there_is_said_where_the_block_begins(unused_port: int) -> None:
    with pytest.raises(ConnectionLost), Robot(f"http://127.0.0.1:{unused_port}"):
        pass
