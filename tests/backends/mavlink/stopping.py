"""A twin behind a relay behind a gateway, which is told to stop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import rcp_mavlink
from backends.mavlink.flying import agrees, airborne, speed, twin
from backends.mavlink.puppet import Puppet
from backends.mavlink.relay import SET_MODE, Relay, relay
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN, OPERATOR, serve_backend
from rcp_mavlink_sim import Twin, Vehicle

KIND = next(iter(rcp_mavlink.rcp_backends()))
BRAKE, LAND, GUIDED = 17, 9, 4
STAYS = 2.0  # s that it is watched to stay at rest
AT_REST = 0.5  # m/s


class Stopped:
    """A twin behind a relay behind a gateway, and an operator."""

    def __init__(self, served: Any, running: Twin, link: Relay) -> None:
        self.served, self.twin, self.relay = served, running, link
        self.vehicle: Vehicle = running.vehicle
        self.client = served.client(OPERATOR)

    @property
    def robot(self) -> Any:
        return self.served.life.backend.robots[""]

    async def moving(self, height: float = 40.0) -> str:
        """Put it in the air and have an action move it; return the id of the action."""
        airborne(self.vehicle, height)
        await agrees(self.served.life.backend, self.vehicle)
        path = "/tenant/t/action/move_to"
        body = {"north": 3000.0, "altitude": height}
        id_ = await self.client.send(type="execute", path=path, body=body)
        await until(lambda: speed(self.vehicle) > 4, "it moves")
        return id_

    async def estop(self, deadline: float = 5.0) -> Any:
        return await self.client.request(
            "execute", "/system/estop", deadline=deadline, within=deadline + 20
        )

    async def reset(self) -> None:
        admin = self.served.client(ADMIN)
        reply = await admin.request("execute", "/system/estop", body={"reset": True})
        assert reply["status"] == "completed", reply

    async def state(self) -> dict[str, Any]:
        reply = await self.client.request("read", "/system/estop")
        (found,) = reply["body"]["robots"].values()
        return found

    async def confirmed(self, within: float = 20.0) -> None:
        async def holds() -> bool:
            return (await self.state())["state"] == "confirmed"

        await eventually(holds, "the stop is confirmed", within)

    async def stays(self, seconds: float = STAYS) -> None:
        """Watch that it does not move."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert speed(self.vehicle) < AT_REST
            await asyncio.sleep(0.02)


@asynccontextmanager
async def flying(options: dict[str, Any] | None = None, **config: Any) -> AsyncGenerator[Stopped]:
    async with (
        twin(**({"speed": 2.0} | (options or {}))) as running,
        relay(running.ports[0]) as link,
    ):
        table = {"links": [f"udpout:127.0.0.1:{link.port}"], "params": [], "silence": 1.5, **config}
        async with serve_backend(KIND, table) as served:
            await until(lambda: bool(served.lives), "it is heard")
            yield Stopped(served, running, link)


async def until(holds: Callable[[], object], what: str, within: float = 60.0) -> None:
    async def check() -> bool:
        return bool(holds())

    await eventually(check, what, within)


class Stubborn(Puppet):
    """An ArduCopter in the air that refuses what a test says."""

    def __init__(self, *refused: int) -> None:
        super().__init__()
        self.mode, self.armed, self.landed = GUIDED, True, 2
        self.move(100.0, 0.0, 20.0)
        self.velocity = (3.0, 0.0, 0.0)
        self.refused = refused
        self.results = {SET_MODE: self._mode, 400: self._arm, 185: self._terminate}

    def _mode(self, command: Any) -> int:
        if int(command.param2) in self.refused:
            self.say("Mode change failed")
            return 4
        self.mode = int(command.param2)
        return 0

    def _arm(self, command: Any) -> int:
        return 4

    def _terminate(self, _: Any) -> int:
        self.armed = False
        return 0
