"""A gateway that records scripted robots, with an HTTP listener and clients of several rights."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx

import rcp_recorder
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.testing import MemoryClient, ScriptedRobot, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import PoseStamped, quantity
from rcp_recordings.names import ACTIVE, NOTICE
from rcp_recordings.names import KIND as KIND_OF
from rcp_recordings.reading import messages, open_recordings

__all__ = ["ADMIN", "HALF", "KIND", "Gateway", "recording"]

(KIND,) = rcp_recorder.rcp_features()
PATH = "/system/recorder"
BOUND = 60.0  # s
ADMIN, HALF = "admin-admin-admin-admin", "half-half-half-half"
Speed = quantity("m/s")


class Gateway:
    """The gateway with its one robot."""

    def __init__(self, served: Served, http: httpx.AsyncClient, folder: Path) -> None:
        self.served = served
        self.folder = folder
        self.http = http
        self.admin: MemoryClient = served.client(ADMIN)
        self.half: MemoryClient = served.client(HALF)

    @property
    def robot(self) -> ScriptedRobot:
        found = self.served.life.backend
        assert isinstance(found, ScriptedRobot)
        return found

    async def get(self, url: str, token: str = ADMIN, **headers: str) -> httpx.Response:
        headers = {"Authorization": f"Bearer {token}", **headers}
        return await self.http.get(f"/rcp/v1/{url}", headers=headers)

    async def until(self, wanted: Callable[[list[dict[str, Any]]], Any]) -> Any:
        """Read the list of recordings until it has what is wanted."""
        async with asyncio.timeout(BOUND):
            while True:
                reply = await self.admin.request("read", PATH)
                if found := wanted(reply["body"]):
                    return found
                await asyncio.sleep(0.02)

    async def written(self, count: int) -> None:
        """Wait until so many messages are in files, and the gateway knows of them.

        What is told of the robot as a whole does not count: when it comes is no test's business.
        """
        async with asyncio.timeout(BOUND):
            while True:
                found = await asyncio.to_thread(_look, self.folder)
                if sum(messages for messages, _ in found) >= count:
                    break
                await asyncio.sleep(0.02)
        total = sum(size for _, size in found)
        await self.until(lambda files: sum(file["bytes"] for file in files) >= total)


def _look(folder: Path) -> list[tuple[int, int]]:
    """Return the messages and bytes of each file, also of those that are being written."""
    found: list[tuple[int, int]] = []
    for file in folder.glob("*.mcap*"):
        with suppress(FileNotFoundError), ExitStack() as stack:  # it is complete now
            size = file.stat().st_size
            for one in open_recordings([(file, size if file.suffix == ACTIVE else None)], stack):
                wanted = messages([one], lambda track: track.facts[KIND_OF] != NOTICE)
                found.append((sum(1 for _ in wanted), size))
    return found


def _robot(host: Host) -> ScriptedRobot:
    made = ScriptedRobot(
        host,
        Resource(name="sensor/speed", description="The speed.", value=Speed),
        Resource(name="sensor/pose", description="The pose.", value=PoseStamped),
        Resource(name="sensor/secret", description="What not all may read.", value=str),
        Resource(name="sensor/text", description="Text.", value=str),
        Resource(name="action/go", description="Goes.", input=Speed),
    )
    made.release.set()
    return made


@asynccontextmanager
async def recording(
    folder: Path, *resources: Resource, tables: str = "", **options: Any
) -> AsyncGenerator[Gateway]:
    """Serve a gateway that records all of its robot."""

    def robot(host: Host) -> ScriptedRobot:
        return ScriptedRobot(host, *resources) if resources else _robot(host)

    config = (
        listener()
        + backend("rover", use="robot")
        + role(
            "half",
            rule("discover read subscribe", "/**"),
            rule("discover execute", "/system/history"),
            rule("discover read execute", PATH),
            deny=[rule("read subscribe", "/sensor/secret")],
        )
        + key("admin", ADMIN, role="admin")
        + key("harry", HALF, roles={"alpha": ["half"]})
        + table(
            "features.recorder",
            **{"folder": folder, "free_mb": 0, "paths": ["/tenant/**"], **options},
        )
        + tables
    )
    async with serve(parse(config, "test"), scripted(robot, "robot"), features=[KIND]) as served:
        for supervisor in served.server.supervisors:
            await asyncio.wait_for(supervisor.settled.wait(), BOUND)
        (url,) = [facts["url"] for facts in served.server.status.transports if "url" in facts]
        async with httpx.AsyncClient(base_url=url, timeout=BOUND, trust_env=False) as http:
            yield Gateway(served, http, folder)
