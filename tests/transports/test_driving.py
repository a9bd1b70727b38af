"""A robot that is driven stops when its driver dies, and obeys one driver at a time."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest

from configuration import backend, key, listener
from conformance.wires import SseClient, WebSocketClient, address
from rcp_gateway.server import Server
from rcp_gateway.testing import Client, Message, serve
from rcp_kernel.clock import parse_time
from rcp_kernel.config.file import parse
from rcp_kernel.values import Encoding
from rcp_sim import SimBackend

pytestmark = pytest.mark.anyio
BOUND = 60.0  # s that any wait may take
VALID_FOR = 0.3  # s
MARGIN = 0.1  # s after which the rover stands still, once nobody's word is in force
SPEED = 0.05  # m/s, from which it takes 20 ms to brake
ATTEMPTS = 3  # at what depends on when this machine lets the gateway run
DRIVE = "/tenant/alpha/actuator/cmd_vel"
PERSON, AGENT = "person-person-person", "agent-agent-agent"
WAYS = ("websocket", "http")
CONFIG = (
    listener(grace=0.1)
    + backend("rover", use="sim", rate=200, noise=0, world="empty")
    + key("person", PERSON, role="operator")
    + key("agent", AGENT)
)
DRIVERS = {
    "websocket": """
import asyncio, sys, rcp_client

async def main(url, token, speed, valid_for):
    async with rcp_client.connect(url, token=token) as robot:
        while True:
            body = {"linear": {"x": float(speed)}}
            await robot.write("/actuator/cmd_vel", body, valid_for=float(valid_for))
            print("driving", flush=True)
            await asyncio.sleep(0.02)

asyncio.run(main(*sys.argv[1:]))
""",
    "http": """
import httpx, sys, time

url, token, speed, valid_for = sys.argv[1:]
headers = {"authorization": f"Bearer {token}"}
with httpx.Client(base_url=url, headers=headers, trust_env=False) as http:
    while True:
        body = {"linear": {"x": float(speed)}}
        path = f"/rcp/v1/context/actuator/cmd_vel?valid_for={valid_for}"
        http.put(path, json=body).raise_for_status()
        print("driving", flush=True)
        time.sleep(0.02)
""",
}


class Log:
    """What reached the rover, in order, with the time at which it was called."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.writes: list[tuple[float, float]] = []
        real = SimBackend.write

        async def write(backend: SimBackend, name: str, value: Any) -> Any:
            if name == "actuator/cmd_vel":
                self.writes.append((time.time(), value.linear.x))
            return await real(backend, name, value)

        monkeypatch.setattr(SimBackend, "write", write)

    @property
    def speeds(self) -> list[float]:
        return [speed for _, speed in self.writes]

    @property
    def driven(self) -> float:
        """When the rover was last told to move."""
        return max(at for at, speed in self.writes if speed)


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> Log:
    return Log(monkeypatch)


class Site:
    """A gateway before a rover, and clients of it that are let go of in the end."""

    def __init__(self, server: Server, stack: AsyncExitStack) -> None:
        self.server = server
        self._stack = stack

    async def client(self, way: str, token: str) -> Client:
        if way == "http":
            made: Client = SseClient(self.server, token, Encoding.JSON)
        else:
            made = await WebSocketClient.connected(self.server, token, Encoding.JSON)
        self._stack.push_async_callback(made.close)
        return made


@pytest.fixture
async def site() -> AsyncGenerator[Site]:
    async with (
        serve(parse(CONFIG, "test")) as served,
        AsyncExitStack() as stack,
        asyncio.timeout(3 * BOUND),
    ):
        yield Site(served.server, stack)


@asynccontextmanager
async def driver(way: str, site: Site) -> AsyncGenerator[asyncio.subprocess.Process]:
    """Have a process of its own drive the rover while entered."""
    arguments = [address(site.server), PERSON, str(SPEED), str(VALID_FOR)]
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", DRIVERS[way], *arguments),
        stdout=subprocess.PIPE,
        env=dict(os.environ),
    )
    try:
        assert process.stdout is not None
        for _ in range(10):
            assert await process.stdout.readline() == b"driving\n"
        yield process
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def standing(watcher: Client, odometry: str, log: Log) -> float:
    """Wait until the rover stands after its last drive; return when that was by its own clock."""
    while True:
        update = await watcher.update(odometry, BOUND)
        stamp = parse_time(update["timestamp"]) / 1e9
        stands = update["body"]["twist"]["linear"]["x"] == 0.0
        if stands and stamp > log.driven and log.speeds[-1] == 0.0:
            return stamp


@pytest.mark.parametrize("lost", [0, 1])
@pytest.mark.parametrize("way", WAYS)
async def test_a_rover_stands_still_soon_after_its_driver_is_killed(
    site: Site, log: Log, way: str, lost: int
) -> None:
    watcher = await site.client("websocket", PERSON)
    odometry = await watcher.subscribe("/sensor/odometry")
    took: list[float] = []
    while len(took) < ATTEMPTS:
        if lost:
            fault = {"fault": "stop_lost", "count": lost}
            done = await watcher.request("execute", "/service/inject_fault", body=fault)
            assert done["status"] == "completed"
        log.writes.clear()
        async with driver(way, site) as process:
            process.send_signal(signal.SIGKILL)
            await process.wait()
            stood = await standing(watcher, odometry, log)
        stops = [at for at, speed in log.writes if not speed]
        assert len(stops) > lost
        assert min(stops) - log.driven > 0.9 * VALID_FOR  # its last word stood that long
        took.append(stood - log.driven)
        if took[-1] <= VALID_FOR + MARGIN:
            return
    pytest.fail(f"the rover stood still only after {took} s")


async def lease(client: Client, do: str, **fields: Any) -> Message:
    body = {"do": do, "scope": "/tenant/alpha", **fields}
    return await client.request("execute", "/system/leases", body=body)


async def drive(client: Client, speed: float) -> Message:
    return await client.request("write", DRIVE, body={"linear": {"x": speed}})


def code(reply: Message) -> str:
    return reply.get("error", {}).get("code", reply["status"])


async def flood(client: Client, driving: asyncio.Event) -> set[str]:
    """Drive by many requests at once until they are refused; return how."""
    refusals: set[str] = set()

    async def go() -> None:
        while code(reply := await drive(client, 0.25)) == "completed":
            driving.set()
        refusals.add(reply["error"]["code"] + ": " + reply["error"]["message"])

    async with asyncio.TaskGroup() as group:
        for _ in range(20):
            group.create_task(go())
    return refusals


@pytest.mark.parametrize("persons", WAYS)
@pytest.mark.parametrize("agents", WAYS)
async def test_a_person_takes_over_and_two_drivers_never_take_turns(
    site: Site, log: Log, agents: str, persons: str
) -> None:
    agent, person = await site.client(agents, AGENT), await site.client(persons, PERSON)
    await agent.subscribe("/sensor/pose", rate=1)  # by SSE, it is how an HTTP client is told
    assert code(await lease(agent, "acquire")) == "completed"
    driving = asyncio.Event()
    work = asyncio.create_task(flood(agent, driving))
    async with asyncio.timeout(BOUND):
        await driving.wait()
    assert code(await drive(person, 0.5)) == "lease_held"
    assert code(await lease(person, "acquire")) == "lease_held"
    assert code(await lease(person, "acquire", take=True)) == "bad_request"
    taken = await lease(person, "acquire", take=True, reason="a person is near")
    assert code(taken) == "completed"
    for _ in range(20):
        assert code(await drive(person, 0.5)) == "completed"

    refusals = await work
    told = await agent.notice("lease_lost")
    assert (told["by"], told["reason"]) == ("person", "a person is near")
    assert refusals
    assert all(text.startswith("lease_lost: ") for text in refusals), refusals
    assert all("a person is near" in text for text in refusals)
    assert code(await drive(agent, 0.25)) == "lease_lost"
    assert code(await lease(agent, "acquire", take=True, reason="mine")) == "lease_held"

    first = log.speeds.index(0.5)
    assert 0.25 in log.speeds[:first]
    assert 0.25 not in log.speeds[first:]
    assert log.speeds.count(0.5) == 20
