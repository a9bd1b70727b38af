"""What comes too late, or from somebody else: it is neither sent after all nor called a refusal."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager, suppress
from types import SimpleNamespace
from typing import Any, cast

import pytest

from backends.ros2.robot import BOUND, Base, Peer, Robot, fresh_domain, ignore, robot_of
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout
from rcp_kernel.spi import Host
from rcp_ros2.caller import _Watch
from rcp_ros2.means import StopCall
from rcp_ros2.ros import Once, Ticket

pytestmark = pytest.mark.anyio
_STOP = {
    "name": "/estop",
    "type": "std_srvs/srv/SetBool",
    "request": {"data": True},
    "released": {"data": False},
}
_DOCK = {"/service/dock": {"service": "/dock", "type": "std_srvs/srv/SetBool"}}


class _Based:
    """A base that nothing else uses, and its domain."""

    def __init__(self) -> None:
        self.domain = fresh_domain()
        self.base = Base(self.domain)
        self.base.start()


@pytest.fixture(scope="module")
def based() -> Iterator[_Based]:
    made = _Based()
    yield made
    made.base.stop()


@asynccontextmanager
async def _docking(based: _Based, **config: Any) -> AsyncIterator[Robot]:
    async with robot_of(based.domain, map=_DOCK, **config) as robot:
        await _offered(robot, "/dock")
        yield robot


async def _offered(robot: Robot, service: str) -> None:
    shared = robot.backend.catalog.shared
    async with asyncio.timeout(BOUND):
        while not shared.graph.has("service", service):  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.02)


@contextmanager
def _busy(robot: Robot) -> Iterator[None]:
    """Keep the ROS thread busy while entered."""
    begun, free = threading.Event(), threading.Event()
    robot.backend.catalog.shared.ros.submit(lambda: (begun.set(), free.wait(BOUND)))
    assert begun.wait(BOUND)
    try:
        yield
    finally:
        free.set()


async def _undocked(robot: Robot) -> None:
    """Have a call answered that comes after all that was sent before, within a time-out of a few tenths."""
    async with asyncio.timeout(BOUND):
        while True:
            with suppress(DeviceTimeout):
                await robot.execute("service/dock", {"data": False})
                return


async def test_a_call_that_was_given_up_is_not_sent_when_the_thread_is_free(based: _Based) -> None:
    async with _docking(based, timeout=0.3) as robot:
        with _busy(robot), pytest.raises(DeviceTimeout):
            await robot.execute("service/dock", {"data": True})
        await robot.backend.catalog.shared.ros.call(ignore)  # what waited for the thread is through
        await _undocked(robot)
        assert not based.base.tell("peak", seconds=5.0)


async def test_what_the_thread_has_not_come_to_in_time_is_never_run(
    based: _Based, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_ros2.ros._PATIENCE", 0.2)
    ran: list[int] = []
    async with _docking(based) as robot:
        ros = robot.backend.catalog.shared.ros
        with _busy(robot), pytest.raises(DeviceTimeout) as caught:
            await ros.call(ran.append, 1)
        assert "nothing was sent" in (caught.value.remedy or "")
        monkeypatch.undo()
        await ros.call(ignore)
        assert not ran


async def test_a_service_that_moves_and_fails_has_begun(domain: int, peer: Peer) -> None:
    steps: list[None] = []
    mapped = {"/service/set_bool": {"service": "/set_bool", "type": "std_srvs/srv/SetBool"}}
    async with robot_of(domain, map=mapped) as robot:
        await robot.until(lambda: "service/set_bool" in robot.resources)
        value = robot.input("service/set_bool", {"data": True})
        await robot.backend.execute("service/set_bool", value, ignore)
        with pytest.raises(DeviceRejected, match="it is so already"):
            await robot.backend.execute(
                "service/set_bool", value, lambda *_, **__: steps.append(None)
            )
        await robot.execute("service/set_bool", {"data": False})
    assert steps


async def test_a_stop_is_not_overtaken_by_the_release_before_it(based: _Based) -> None:
    """Both wait for the service to be matched, as after a restart of its node."""
    async with _docking(based, stop={"service": _STOP, "feedback": False}) as robot:
        await _offered(robot, "/estop")
        shared = robot.backend.catalog.shared
        call = StopCall(shared, shared.config.stop.service, None)
        await call.engage()
        client: Any = call._caller._client  # noqa: SLF001 - which looks for the service
        looks = 0
        ready = client.is_ready

        def found() -> bool:
            nonlocal looks
            looks += 1
            return looks >= 4 and ready()

        client.is_ready = found
        call.release()
        await asyncio.sleep(0.01)
        await call.engage()
        await asyncio.sleep(0.1)  # in which the release would come
        assert based.base.tell("truth")["brakes"] == ["service"]
        client.is_ready = ready
        call.release()
        async with asyncio.timeout(BOUND):
            while based.base.tell("truth")["brakes"]:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        await call.close()


async def test_a_stop_on_its_way_is_sent_although_the_backend_closes(based: _Based) -> None:
    async with _docking(based, stop={"service": _STOP, "feedback": False}) as robot:
        await _offered(robot, "/estop")
        shared = robot.backend.catalog.shared
        call = StopCall(shared, shared.config.stop.service, None)
        await shared.ros.call(call.prepare)
        with _busy(robot):
            stopping = asyncio.ensure_future(call.engage())
            await asyncio.sleep(0)
            closing = asyncio.ensure_future(call.close())
            await asyncio.sleep(0)
        await closing
        await stopping
        assert based.base.tell("truth")["brakes"] == ["service"]
        releasing = StopCall(shared, shared.config.stop.service, None)
        releasing.engaged = True
        releasing.release()
        async with asyncio.timeout(BOUND):
            while based.base.tell("truth")["brakes"]:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        await releasing.close()


async def test_a_call_that_cannot_be_judged_does_not_leave_the_others_without_a_limit() -> None:
    def fault(_once: Once, limit: float, left: float) -> Exception | None:
        if limit < 0.02:
            raise RuntimeError("a bug")
        return TimeoutError("too late") if left <= 0 else None

    watch = _Watch(fault)
    host = cast("Host", SimpleNamespace())
    first, second = Ticket(host), Ticket(host)
    watch.add(first, 0.01, Once())
    watch.add(second, 0.05, Once())
    with pytest.raises(RuntimeError, match="a bug"):
        await asyncio.wait_for(first.answer(), BOUND)
    watch.remove(first)
    with pytest.raises(TimeoutError, match="too late"):
        await asyncio.wait_for(second.answer(), 60.0)


class _Pair:
    """Two nodes with the same services and actions, and their domain: one accepts goals late, one none."""

    def __init__(self) -> None:
        self.domain = fresh_domain()
        self.late, self.strict = Peer(self.domain, "late"), Peer(self.domain, "strict")

    def each(self, do: Callable[[Peer], None]) -> None:
        with ThreadPoolExecutor() as threads:
            list(threads.map(do, (self.late, self.strict)))


@pytest.fixture(scope="module")
def pair() -> Iterator[_Pair]:
    made = _Pair()
    made.each(Peer.start)
    yield made
    made.each(Peer.stop)


async def test_a_goal_that_one_of_two_servers_rejects_is_cancelled_at_the_other(
    pair: _Pair,
) -> None:
    steps: list[Any] = []
    async with robot_of(pair.domain, map={"/action/fibonacci": {"action": "/fibonacci"}}) as robot:
        await robot.until(lambda: "action/fibonacci" in robot.resources)
        run: Any = robot.backend.catalog.bindings["action/fibonacci"]
        async with asyncio.timeout(BOUND):
            await run.reach()
            while len(run.nodes) < 2:
                await robot.backend.catalog.shared.ros.call(run.servers)
                await asyncio.sleep(0.02)
        goal = robot.input("action/fibonacci", {"order": 2000})
        with pytest.raises(DeviceRejected, match="/late and /strict serve it"):
            await robot.backend.execute(
                "action/fibonacci", goal, lambda *_, **__: steps.append(None)
            )
        assert steps  # so that it is `failed`, not `rejected`
        async with asyncio.timeout(BOUND):
            while not pair.late.truth()["began"] or pair.late.truth()["running"]:  # noqa: ASYNC110
                await asyncio.sleep(0.02)


async def test_a_call_whose_node_vanishes_is_not_called_a_refusal(pair: _Pair) -> None:
    slow: dict[str, Any] = {"service": "/slow", "type": "std_srvs/srv/Trigger", "timeout": 20.0}
    async with robot_of(pair.domain, map={"/service/slow": slow}) as robot:
        await _offered(robot, "/slow")
        caller: Any = robot.backend.catalog.bindings["service/slow"]
        calling = asyncio.ensure_future(robot.execute("service/slow"))
        async with asyncio.timeout(BOUND):
            while not caller._caller._client or not caller._caller._client.waiting:  # noqa: ASYNC110, SLF001 - until it is sent
                await asyncio.sleep(0.02)
        await asyncio.to_thread(pair.each, Peer.withdraw)
        with pytest.raises(AdapterUnavailable, match="has disappeared") as caught:
            await asyncio.wait_for(calling, BOUND)
        assert (caught.value.status, caught.value.retryable) == ("failed", False)
