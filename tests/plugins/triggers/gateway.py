"""A gateway with triggers, around robots that a test moves."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import rcp_triggers
from configuration import backend, key, role, rule, table
from plugins.triggers.receiver import KEY
from rcp_gateway.testing import MemoryClient, ScriptedRobot, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.features import FeatureKind
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import quantity

(KIND,) = rcp_triggers.rcp_features()
TRIGGERS, ALARMS, FIRINGS = "/system/triggers", "/system/alarms", "/system/firings"
OPERATOR, ADMIN, LIMITED, OTHER = (
    f"{n}-{n}-{n}" for n in ("operator", "admin", "limited", "other")
)
Level = quantity("1", ge=0, le=100)
BOUND = 60.0  # s


def robot(host: Host) -> ScriptedRobot:
    made = ScriptedRobot(
        host,
        Resource(name="sensor/battery", description="The battery.", value=Level),
        Resource(name="sensor/secret", description="Not for all.", value=Level),
        Resource(name="sensor/name", description="Its name.", value=str),
        Resource(name="sensor/heat", description="Its heat.", value=Level, deadline=5.0),
        Resource(name="event/fault", description="A fault.", value=int),
        Resource(name="actuator/drive", description="The drive.", value=Level, safe=0.0),
        Resource(name="action/dock", description="Docks.", input=Level),
    )
    made.release.set()
    return made


class Rig:
    """A running gateway."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.admin = served.client(ADMIN)
        self.operator = served.client(OPERATOR)
        self._subscription = ""

    def client(self, token: str) -> MemoryClient:
        return self.served.client(token)

    def robot(self, kind: str = "robot") -> ScriptedRobot:
        found = next(life.backend for life in reversed(self.served.lives) if life.kind == kind)
        assert isinstance(found, ScriptedRobot)
        return found

    async def follow(self) -> None:
        """Hear of all that happens to triggers from now on."""
        self._subscription = await self.admin.subscribe(
            FIRINGS, initial=False, qos={"reliability": "reliable"}
        )

    async def happened(self, what: str) -> dict[str, Any]:
        """Wait for something to happen to a trigger."""
        message = await self.admin.until(
            lambda m: (
                m["type"] == "update"
                and m["id"] == self._subscription
                and m["body"]["what"] == what
            )
        )
        return message["body"]

    async def add(self, client: MemoryClient | None = None, **spec: Any) -> dict[str, Any]:
        given = {"name": "low", "robot": "/tenant/alpha", "when": "sensor.battery < 20", **spec}
        return await (client or self.operator).request("execute", TRIGGERS, body={"add": given})

    async def made(self, client: MemoryClient | None = None, **spec: Any) -> None:
        reply = await self.add(client, **spec)
        assert reply["status"] == "completed", reply

    async def row(self, name: str = "low", client: MemoryClient | None = None) -> dict[str, Any]:
        reply = await (client or self.admin).request("read", TRIGGERS)
        return next(one for one in reply["body"] if one["trigger"] == name)

    async def on_robot(self, name: str = "low") -> dict[str, Any]:
        return (await self.row(name))["robots"][0]

    async def alarms(self, client: MemoryClient | None = None) -> list[dict[str, Any]]:
        return (await (client or self.admin).request("read", ALARMS))["body"]

    async def eventually(self, what: Callable[[], Any]) -> Any:
        """Wait until a coroutine function returns something true."""
        async with asyncio.timeout(BOUND):
            while not (found := await what()):  # noqa: ASYNC110 - it asks over the wire
                await asyncio.sleep(0.01)
        return found


def webhook(url: str, **more: Any) -> dict[str, Any]:
    return {"kind": "webhook", "url": url, "secret": KEY, **more}


@asynccontextmanager
async def gateway(
    *tables: str,
    store: Path | None = None,
    clock: Clock = SYSTEM_CLOCK,
    features: tuple[FeatureKind, ...] = (),
    robots: str = backend("rover") + backend("other", "beta", use="second"),
    **options: Any,
) -> AsyncGenerator[Rig]:
    hidden = [rule("discover read subscribe", "/sensor/secret")]
    config = "".join(
        (
            robots,
            role("limited", rule("*", "/**"), rule("*", "/system/**"), deny=hidden),
            role("steward", rule("*", "/**"), rule("*", "/system/**"), reset=True),
            key("admin", ADMIN),
            key("operator", OPERATOR, roles={"alpha": ["operator"]}),
            key("limited", LIMITED, roles={"alpha": ["limited"]}),
            key("other", OTHER, roles={"beta": ["admin"]}),
            table("features.triggers", **options),
            table("store", path=store) if store is not None else "",
            *tables,
        )
    )
    kinds = (scripted(robot), scripted(robot, "second"))
    async with serve(config, *kinds, clock=clock, features=(KIND, *features)) as served:
        yield Rig(served)
