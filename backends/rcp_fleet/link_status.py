"""`sensor/<robot>/link`: what the hub knows of a robot's gateway, also while it is away."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

from rcp_fleet.messages import GatewayLink, LinkState
from rcp_kernel.clock import iso, now
from rcp_kernel.model import Operation, Resource
from rcp_kernel.spi import Host, RobotLink
from rcp_protocol.timeouts import timeout
from rcp_zenoh.statistics import LinkStatistics

__all__ = ["LinkStatus"]

_PERIOD = 1.0  # s between two samples; a change of state is published at once


class LinkStatus:
    """The state of one robot's gateway, and of the links with it."""

    def __init__(self, host: Host, robot: str, statistics: LinkStatistics) -> None:
        self._host, self._statistics = host, statistics
        self.name = f"sensor/{robot}/link"
        self._loop = asyncio.get_running_loop()
        self._state: LinkState = "down"
        self._detail: str | None = "it has not answered yet"
        self._trouble: str | None = None
        """Why its robot is not ready, as the gateway says."""
        self._version: str | None = None
        self._protocol: str | None = None
        self._lacks: set[str] = set()
        self._changed = asyncio.Event()
        # The hub's own, and no resource of the robot: these cannot be read while it is down.
        resource = Resource(
            name=self.name,
            description=f"The gateway of '{robot}' as this hub reaches it: state, version, delay, "
            "losses, bytes, clock.",
            value=GatewayLink,
            operations=Operation.READ | Operation.SUBSCRIBE,
            meta={"gateway": robot},
        )
        host.declare(resource)

    def down(self, why: str) -> None:
        """Note that the gateway cannot be used."""
        self._state, self._detail = "down", why
        self._changed.set()

    def ready(self) -> None:
        """Note that the gateway serves its robot."""
        self._state = "ready"
        self._changed.set()

    def speaks(self, protocol: str | None) -> None:
        """Note the version of RCP in the gateway's greeting."""
        if protocol != self._protocol:
            self._protocol = protocol
            self._changed.set()

    def runs(self, version: str | None) -> None:
        """Note the version of the gateway."""
        self._version = version
        self._changed.set()

    def lacks(self, path: str) -> None:
        """Note that the gateway does not offer a path of its own to this hub."""
        self._lacks.add(path)
        self._changed.set()

    def offers(self, path: str) -> None:
        """Note that it does."""
        if path in self._lacks:
            self._lacks.remove(path)
            self._changed.set()

    def robots(self, listed: list[dict[str, Any]]) -> None:
        """Note what the gateway's inventory says of the robots behind it."""
        states = {one["path"]: one["state"] for one in listed if one["state"] != "ready"}
        told = ", ".join(f"{path} is {state}" for path, state in states.items())
        trouble = f"its gateway says: {told}" if told else None
        if trouble != self._trouble:
            self._trouble = trouble
            self._changed.set()

    def value(self) -> GatewayLink:
        """Describe the link now."""
        self._statistics.count()
        row, heard = self._statistics.row, self._statistics.heard
        state, detail = self._state, self._detail
        if state == "ready":
            state, detail = (
                ("ready", None) if self._trouble is None else ("degraded", self._trouble)
            )
        return GatewayLink(
            state=state,
            detail=detail,
            version=self._version,
            protocol=self._protocol,
            lacks=tuple(sorted(self._lacks)),
            latency=None if state == "down" else row.get("latency"),
            clock_offset=row.get("clock_offset"),
            clock_bound=row.get("clock_bound"),
            sent=row["sent"],
            received=row["received"],
            links=row["links"],
            lost=row["lost"],
            last_seen=None if heard is None else self._time(heard),
            last_end=row.get("last_end"),
        )

    def carried(self) -> RobotLink:
        """Return what metrics tell of it."""
        self._statistics.count()
        row = self._statistics.row
        return RobotLink(
            latency=None if self._state == "down" else row.get("latency"),
            sent=row["sent"],
            received=row["received"],
            lost=row["lost"],
        )

    def _time(self, moment: float) -> str:
        return iso(now() - round((self._loop.time() - moment) * 1e9))

    @asynccontextmanager
    async def watch(self, rate: float | None) -> AsyncGenerator[None]:
        """Publish it while somebody looks, and only then."""
        period = _PERIOD if rate is None else max(_PERIOD, 1 / rate)
        task = asyncio.create_task(self._publish(period), name=f"fleet {self.name}")
        try:
            yield
        finally:
            task.cancel()

    async def _publish(self, period: float) -> None:
        while True:
            self._changed.clear()
            self._host.publish(self.name, self.value())
            try:
                async with timeout(period):
                    await self._changed.wait()
            except TimeoutError:
                pass
