"""A hub and the gateways of its robots, joined by Zenoh over real sockets of this machine."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from configuration import backend, configuration, key, table
from rcp_gateway.testing import ADMIN, OPERATOR, Client, Served, eventually, serve
from rcp_kernel.config.file import parse
from rcp_kernel.spi import BackendKind

__all__ = [
    "SIM",
    "appears",
    "catalogue",
    "hub_at",
    "process_of",
    "recorded",
    "robot_at",
    "serving",
]

SIM = backend("rover", use="sim")
_OPERATOR = key("operator", OPERATOR)
_BOUND = 60.0  # s, on any machine


def robot_at(port: int, robot: str = SIM, gateway: str = "r7") -> str:
    """Return the configuration of a robot's gateway."""
    hub = [f"tcp/127.0.0.1:{port}"]
    zenoh = table("transports.zenoh", gateway=gateway, tenant="alpha", connect=hub)
    return configuration(zenoh, robot, _OPERATOR)


def hub_at(port: int, hub: str = "h1", *, router: bool = True) -> str:
    """Return the configuration of a hub, which is the router or joins it."""
    ends = {"listen" if router else "connect": [f"tcp/127.0.0.1:{port}"]}
    fleet = backend("fleet", use="fleet", hub=hub, token=OPERATOR, **ends)
    return configuration(fleet, _OPERATOR)


@asynccontextmanager
async def serving(text: str, *kinds: BackendKind) -> AsyncGenerator[Served]:
    """Run a gateway whose transports are open."""
    async with serve(parse(text, "test"), *kinds) as served:
        yield served


@asynccontextmanager
async def process_of(
    file: Path, text: str, environment: Mapping[str, str] | None = None
) -> AsyncGenerator[asyncio.subprocess.Process]:
    """Run a gateway as a process of its own."""
    file.write_text(text)  # noqa: ASYNC240 - a few lines
    rcpd = Path(sys.executable).with_name("rcpd")
    nobody = asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(
        rcpd, "serve", file, stdout=nobody, stderr=nobody, env={**os.environ, **(environment or {})}
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):  # the test has killed it
            os.kill(process.pid, signal.SIGCONT)
            process.kill()
        await process.wait()


async def catalogue(client: Client, pattern: str = "/tenant/**") -> dict[str, dict[str, Any]]:
    """Return what discovery says, by path."""
    found: dict[str, dict[str, Any]] = {}
    body: dict[str, Any] = {"limit": 1000}
    while True:
        reply = await client.request("discover", path=pattern, body=body)
        assert reply["status"] == "completed", reply
        found |= {one["path"]: one for one in reply["body"]["resources"]}
        if "cursor" not in reply["body"]:
            return found
        body["cursor"] = reply["body"]["cursor"]


async def appears(client: Client, path: str) -> dict[str, Any]:
    """Return what discovery says of a path, once it is there."""
    found: dict[str, Any] = {}

    async def there() -> bool:
        found.update(await catalogue(client, path))
        return path in found

    await eventually(there, f"{path} is there", _BOUND)
    return found[path]


async def recorded(served: Served, test: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Return the first record of a gateway's audit log that passes a test."""
    admin = served.client(ADMIN)
    id_ = await admin.subscribe("/system/audit", history=100, qos={"depth": 100})

    def holds(message: dict[str, Any]) -> bool:
        body = message.get("body")
        return message.get("id") == id_ and isinstance(body, dict) and test(body)

    found = await admin.until(holds, _BOUND)
    await admin.close()
    return found["body"]
