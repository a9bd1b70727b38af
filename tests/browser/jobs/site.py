"""One gateway for all jobs: a rover, an arm and a copter, alarms, recordings and people."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import msgspec
from websockets.asyncio.client import ClientConnection, connect

import rcp_mavlink
import rcp_sim
from browser.robots import until, value
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import quantity
from rcp_store.tokens import TokenFile

__all__ = ["ARM", "DRONE", "KEYS", "ROVER", "Site", "site"]

ROVER, ARM, DRONE = "/tenant/alpha", "/tenant/beta", "/tenant/gamma"
KEYS = {name: f"key-of-{name}-which-is-long" for name in ("ada", "lena", "otto")}
LOW = {
    "robot": ARM,
    "when": "sensor.battery < 20",
    "alarm": True,
    "severity": "critical",
    "message": "Battery low",
}


class Elbow(msgspec.Struct, frozen=True):
    """Where a joint is."""

    position: quantity("rad") = 0.0  # pyright: ignore[reportInvalidTypeForm]


_RESOURCES = (
    Resource(name="sensor/battery", description="The charge.", value=quantity("1", ge=0, le=100)),
    Resource(name="sensor/elbow", description="Where it is.", value=Elbow, live=True),
    Resource(
        name="actuator/elbow",
        description="The elbow.",
        value=quantity("rad", ge=-1, le=1),
        safe=0.0,
    ),
    Resource(name="param/limit", description="A limit.", value=quantity("m/s", ge=0, le=2.5)),
    Resource(name="event/fault", description="What is wrong.", value=Any),
    Resource(name="action/sweep", description="Goes on and on."),
    Resource(
        name="service/add", description="Adds one.", input=quantity("1"), output=quantity("1")
    ),
)


class Arm(ScriptedRobot):
    """An arm that is where it was told to be, and tells so."""

    async def tell(self) -> None:
        """Tell where it is, for ever."""
        while True:
            self.host.publish("sensor/elbow", Elbow(self.values["actuator/elbow"]))
            await asyncio.sleep(0.2)

    async def write(self, name: str, value: Any) -> Any:
        await super().write(name, value)
        self.host.publish(name, value)


def _arm(host: Host) -> Arm:
    made = Arm(host, *_RESOURCES, values={"actuator/elbow": 0.0, "param/limit": 1.0})

    async def add(value: Any, progress: Any) -> Any:
        return value + 1

    made.behaviours["service/add"] = add
    host.publish("sensor/battery", 90.0)
    host.publish("param/limit", 1.0)
    return made


class Site:
    """Where the gateway is, and its robots past the page."""

    def __init__(self, url: str, arm: ScriptedRobot, store: Path) -> None:
        self.url = url
        self.arm = arm
        self.tokens = TokenFile(store)
        self.clients = {
            name: httpx.AsyncClient(
                base_url=url, headers={"authorization": f"Bearer {secret}"}, timeout=60
            )
            for name, secret in KEYS.items()
        }
        self.ada = self.clients["ada"]

    async def ask(self, path: str, body: Any = None, who: str = "ada") -> Any:
        """Execute something to its end."""
        got = await self.clients[who].post(f"/rcp/v1/context{path}", json=body, params={"wait": 60})
        answer = got.json()
        assert answer["status"] == "completed", answer
        return answer.get("body")

    async def value(self, path: str) -> Any:
        return await value(self.ada, path)

    async def until(self, path: str, holds: Any) -> Any:
        return await until(self.ada, path, holds)

    @asynccontextmanager
    async def session(self, who: str) -> AsyncGenerator[ClientConnection]:
        """Be connected by a program of somebody."""
        headers = {"authorization": f"Bearer {KEYS[who]}"}
        address = self.url.replace("http", "ws", 1) + "/rcp/v1/ws"
        async with connect(address, additional_headers=headers, proxy=None) as socket:
            await socket.send(json.dumps({"type": "hello", "id": "1"}))
            await socket.recv()
            yield socket

    async def reset(self) -> None:
        """Allow all robots to move again."""
        await self.ask("/system/estop", {"reset": True})

    async def ground(self) -> None:
        """Have the copter switched off."""
        await self.ask(f"{DRONE}/action/disarm", {"force": True})
        await self.until(f"{DRONE}/sensor/prearm", lambda told: told["ready"])

    async def rise(self) -> None:
        """Have the copter in the air."""
        if await self.value(f"{DRONE}/sensor/armed"):
            return
        await self.until(f"{DRONE}/sensor/prearm", lambda told: told["ready"])
        await self.ask(f"{DRONE}/action/set_mode", {"mode": "GUIDED"})
        await self.ask(f"{DRONE}/action/arm", {})
        await self.ask(f"{DRONE}/action/takeoff", {"altitude": 3})


@asynccontextmanager
async def site(folder: Path) -> AsyncGenerator[Site]:
    """Run it while entered; the folder is for what it keeps."""
    configure("error", "json")
    arms: list[Arm] = []

    def made(host: Host) -> Arm:
        arms.append(_arm(host))
        return arms[0]

    text = (
        table("store", path=str(folder / "store.db"))
        + listener()
        + table("plugins.dashboard")
        + table("features.triggers", rules={"low": LOW})
        + table(
            "features.recorder", folder=str(folder / "recordings"), free_mb=0, paths=[f"{ARM}/**"]
        )
        + table("features.recorder.black_box", seconds=5, after=0.2)
        + backend("rover", use="sim", rate=20, scan_rate=2, points_rate=1)
        + backend("arm", "beta", use="arm")
        + backend("drone", "gamma", use="mavlink", links=["sim:copter"], on_loss="hold")
        + table("backends.twin", warmup=0.5, speed=4, noise=0)
        + key("ada", KEYS["ada"], role="admin")
        + key("otto", KEYS["otto"], role="operator")
        + key("lena", KEYS["lena"], role="learner")
        + role("learner", rule("*", "/**", "/system/commands"), approve=["/param/**"])
    )
    kinds = (
        scripted(made, "arm"),
        *rcp_mavlink.rcp_backends(),
        *rcp_sim.rcp_backends(),
    )
    async with serve(parse(text, "test"), *kinds) as served:
        url = next(facts["url"] for facts in served.server.status.transports if "url" in facts)
        telling = asyncio.create_task(arms[0].tell())
        found = Site(url, arms[0], folder / "store.db")
        try:
            yield found
        finally:
            telling.cancel()
            await asyncio.gather(telling, return_exceptions=True)
            await asyncio.gather(*(client.aclose() for client in found.clients.values()))
