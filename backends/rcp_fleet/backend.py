"""The fleet as a backend: each gateway below its tenant is one of its robots."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import zenoh

from rcp_fleet.access import access_rules
from rcp_fleet.config import FleetConfig
from rcp_fleet.gateway import RemoteGateway
from rcp_fleet.revocations import Revocations
from rcp_fleet.types import RobotTypes
from rcp_hubs.signer import HubSigner, read_private_key
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.errors import ConfigError
from rcp_kernel.spi import BaseBackend, Host, Progress
from rcp_zenoh.keys import alive, part
from rcp_zenoh.session import configuration, on_loop, opened
from rcp_zenoh.tls import check_links

__all__ = ["FleetBackend", "open_fleet"]


class FleetBackend(BaseBackend):
    """Passes every operation to the gateway whose resource it concerns."""

    on_loss = "continue"  # the robot's own gateway decides

    def __init__(
        self,
        config: FleetConfig,
        session: zenoh.Session,
        host: Host,
        signer: HubSigner | None,
        revocations: Revocations | None,
    ) -> None:
        self._config, self._session, self._host = config, session, host
        self._signer, self._revocations = signer, revocations
        self._types = RobotTypes()
        self.gateways: dict[str, RemoteGateway] = {}

    def token(self, sample: zenoh.Sample) -> None:
        """Note that a gateway has come or gone."""
        name, here = part(sample.key_expr, 2), sample.kind == zenoh.SampleKind.PUT
        if here and self._revocations is not None:
            self._revocations.hasten()
        known = self.gateways.get(name)
        if known is None and here:
            known = self.gateways[name] = RemoteGateway(
                self._config,
                self._session,
                self._host,
                self._types,
                self._signer,
                name,
                self._review,
            )
        if known is not None:
            known.alive(here=here)

    def _review(self) -> None:
        away = sorted(name for name, gateway in self.gateways.items() if not gateway.ready)
        if not away:
            self._host.report(None)
            return
        shown = ", ".join(away[:5]) + (f" and {len(away) - 5} more" if len(away) > 5 else "")
        # Down ends the commands in the kernel; those of a gateway go on without this link.
        down = not any(one.ready or one.commands for one in self.gateways.values())
        self._host.report(f"not reachable: {shown}", down=down)

    def _of(self, name: str) -> RemoteGateway:
        return self.gateways[name.split("/", 2)[1]]

    async def read(self, name: str) -> Any:
        """Read at the robot's gateway."""
        return await self._of(name).read(name)

    async def write(self, name: str, value: Any) -> Any:
        """Write at the robot's gateway."""
        return await self._of(name).write(name, value)

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Write several values of one robot as one."""
        return await self._of(next(iter(values))).write_together(values)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Execute at the robot's gateway."""
        return await self._of(name).execute(name, value, progress)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Subscribe at the robot's gateway, once for all subscribers here."""
        return self._of(name).watch(name, rate)

    async def halt(self) -> None:
        """Stop every robot; all are asked at once."""
        async with asyncio.TaskGroup() as group:
            for gateway in self.gateways.values():
                group.create_task(gateway.stop())

    async def halt_robot(self, robot: str) -> None:
        """Stop one robot."""
        await self.gateways[robot].stop()

    async def recover(self, robot: str | None) -> str:
        """Do nothing: what runs on a robot was never cut off from its own gateway."""
        return f"left to the gateway of {robot}"

    async def close(self) -> None:
        """End all sessions."""
        await asyncio.gather(*(one.close() for one in self.gateways.values()))


@asynccontextmanager
async def open_fleet(config: FleetConfig, host: Host) -> AsyncGenerator[FleetBackend]:
    """Serve the gateways that a router knows, and be that router if `listen` says so."""
    if not config.listen and not config.connect:
        raise ConfigError(
            "the fleet has no router: `listen` makes this hub one, `connect` names others"
        )
    if (config.key is None) == (config.token is None):
        raise ConfigError(
            "the fleet needs `key`, the file of this hub's private key, or `token` for a trial in "
            "which everybody acts as the hub"
        )
    signer = None
    if config.key is not None:
        signer = HubSigner(config.hub, read_private_key(config.key, "`key`"), SYSTEM_CLOCK)
    mode = "router" if config.listen else "client"
    loop = asyncio.get_running_loop()
    check_links((*config.listen, *config.connect), config.tls, "the fleet")
    if (config.robots or config.hubs) and (config.tls is None or not config.listen):
        raise ConfigError(
            "the fleet: `robots` and `hubs` are the rules of a router with `listen` and `tls`"
        )
    access = None
    if config.tls is not None and config.listen:
        access = access_rules(host.tenant, config.robots, config.hubs)
    zenoh_config = configuration(
        mode,
        listen=config.listen,
        connect=config.connect,
        silence=config.silence,
        tls=config.tls,
        access=access,
    )
    async with opened(zenoh_config, patient=False) as session:
        revocations = None
        if config.revoked is not None:
            revocations = Revocations(session, host.tenant, config.revoked)
        backend = FleetBackend(config, session, host, signer, revocations)
        repeating = loop.create_task(_repeat(revocations), name="fleet revocations")
        tokens = session.liveliness().declare_subscriber(
            alive(host.tenant), on_loop(loop, backend.token), history=True
        )
        try:
            yield backend
        finally:
            repeating.cancel()
            tokens.undeclare()
            await backend.close()


async def _repeat(revocations: Revocations | None) -> None:
    if revocations is not None:
        await revocations.run()
