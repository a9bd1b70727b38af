"""The fleet as a backend: each gateway below its tenant is one of its robots."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from functools import partial
from typing import Any

import structlog
import zenoh

from rcp_fleet.access import access_rules
from rcp_fleet.config import FleetConfig
from rcp_fleet.gateway import RemoteGateway
from rcp_fleet.link import FleetLinks
from rcp_fleet.link_names import LinkNames
from rcp_fleet.refusals import Refusals
from rcp_fleet.revocations import Revocations
from rcp_fleet.stops import RobotStop
from rcp_fleet.types import RobotTypes
from rcp_hubs.signer import HubSigner, read_private_key
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceTimeout,
    RcpError,
    UnsupportedOperation,
)
from rcp_kernel.spi import (
    BaseBackend,
    FrameWatch,
    Host,
    MotionState,
    Progress,
    RobotLease,
    RobotLeaseRequest,
    RobotLink,
    caller,
)
from rcp_zenoh.inbox import received
from rcp_zenoh.keys import alive, part
from rcp_zenoh.session import configuration, opened

__all__ = ["FleetBackend", "open_gateways"]

log = structlog.get_logger("rcp.fleet")


class FleetBackend(BaseBackend):
    """Passes every operation to the gateway whose resource it concerns."""

    on_loss = "continue"  # the robot's own gateway decides
    has_gateways = True

    def __init__(
        self,
        config: FleetConfig,
        links: FleetLinks,
        host: Host,
        signer: HubSigner | None,
        revocations: Revocations | None,
    ) -> None:
        self._config, self._links, self._host = config, links, host
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
            known = self._add(name)
        if known is not None:
            known.alive(here=here)

    def _add(self, name: str) -> RemoteGateway | None:
        """Begin a session with a gateway, unless it has a name that no robot can have here."""
        try:
            gateway = RemoteGateway(
                self._config, self._links, self._host, self._types, self._signer, name
            )
        except RcpError as error:
            log.warning("fleet_gateway_ignored", gateway=name, reason=error.message)
            return None
        self.gateways[name] = gateway
        return gateway

    def _of(self, name: str) -> RemoteGateway:
        return self._gateway(name.split("/", 2)[1])

    async def read(self, name: str) -> Any:
        """Read at the robot's gateway."""
        return await self._of(name).read(name)

    async def read_in_frame(self, name: str, frame: str) -> Any:
        """Read at the robot's gateway, which converts the value."""
        return await self._of(name).read_in_frame(name, frame)

    def frames_of(self, name: str) -> Sequence[str]:
        """Return what the robot's gateway listed, a while ago at most; nothing before it is here."""
        gateway = self.gateways.get(name.split("/", 2)[1])
        return () if gateway is None else gateway.frames_of(name)

    def watch_in_frame(self, name: str, watch: FrameWatch) -> Callable[[], None]:
        """Subscribe at the robot's gateway as the person who wants the values."""
        robot = name.split("/", 2)[1]
        # After a reload, the subscriber may be here before the robot.
        gateway = self.gateways.get(robot) or self._add(robot) or self._gateway(robot)
        return gateway.watch_in_frame(name, watch)

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
        """Stop every robot: all are asked at once, and each to the end.

        :raises DeviceTimeout: one is not at rest, or has not answered.
        """
        names = list(self.gateways)
        stops = (self.gateways[name].stops.stop() for name in names)
        found = await asyncio.gather(*stops, return_exceptions=True)
        late = [name for name, error in zip(names, found, strict=True) if error is not None]
        if late:
            raise DeviceTimeout(f"not stopped: {', '.join(late)}")

    async def halt_robot(self, robot: str) -> None:
        """Stop one robot by its own gateway's e-stop."""
        await self._stops(robot).stop()

    def _stops(self, robot: str) -> RobotStop:
        return self._gateway(robot).stops

    def _gateway(self, robot: str) -> RemoteGateway:
        """Return the gateway of a robot.

        :raises AdapterUnavailable: it has not been seen since the hub began.
        """
        gateway = self.gateways.get(robot)
        if gateway is None:
            raise AdapterUnavailable(f"the gateway of '{robot}' has not been seen")
        return gateway

    def robot_link(self, robot: str) -> RobotLink | None:
        """Report what the links with the gateway of a robot have carried."""
        gateway = self.gateways.get(robot)
        return None if gateway is None else gateway.link.carried()

    def motion(self, robot: str | None) -> MotionState | None:
        """Report what the gateways say of their stops."""
        if robot is not None:
            return self._stops(robot).motion()
        states = {name: one.stops.motion() for name, one in self.gateways.items()}
        late = {name: one for name, one in states.items() if not one.at_rest}
        if not late:
            return MotionState(at_rest=True) if states else None
        moves = any(one.at_rest is False for one in late.values())
        detail = "; ".join(f"{name}: {one.detail}" for name, one in late.items())
        return MotionState(False if moves else None, detail)

    def hold_stop(self, robot: str | None) -> None:
        """Ask again those gateways that are not known to hold their robots."""
        names = self.gateways if robot is None else [robot]
        for name in names:
            if name in self.gateways:
                self.gateways[name].stops.hold()

    async def hold(self, robot: str | None) -> None:
        """Refuse: a robot that can hold has a service for it; for nobody in particular, do nothing.

        When this hub was frozen, or somebody lost control here, the robots' own gateways decide.
        """
        if caller() is not None:
            raise UnsupportedOperation(f"the gateway of '{robot}' offers no hold")

    async def recover(self, robot: str | None) -> str:
        """Leave it to the robot's gateway."""
        return "left to its own gateway"

    async def reset_estop(self, robot: str | None) -> None:
        """Ask the gateway of a robot, or all of them."""
        names = list(self.gateways) if robot is None else [robot]
        for name in names:
            self._stops(name)
        await asyncio.gather(*(self.gateways[name].reset_estop() for name in names))

    async def lease(self, robot: str, request: RobotLeaseRequest) -> RobotLease:
        """Ask the gateway of a robot."""
        return await self._gateway(robot).lease(request)

    async def close(self) -> None:
        """End all sessions."""
        await asyncio.gather(*(one.close() for one in self.gateways.values()))


@asynccontextmanager
async def open_gateways(config: FleetConfig, host: Host) -> AsyncGenerator[FleetBackend]:
    """Serve the gateways that a router knows, and be that router if `listen` says so."""
    signer = None
    if config.key is not None:
        signer = HubSigner(config.hub, read_private_key(config.key, "`key`"), SYSTEM_CLOCK)
    mode = "router" if config.listen else "client"
    loop = asyncio.get_running_loop()
    access = None
    if config.tls is not None and config.listen:
        access = access_rules(host.tenant, config.robots, config.hubs, config.routers)
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
        names = LinkNames(loop.time)
        links = FleetLinks(session, names, host.tenant, config.hub, config.silence)
        backend = FleetBackend(config, links, host, signer, revocations)
        tokens = partial(session.liveliness().declare_subscriber, alive(host.tenant), history=True)
        repeating = loop.create_task(_repeat(revocations), name="fleet revocations")
        served = {*config.robots, *config.hubs, *config.routers}
        refusals = nullcontext() if access is None else Refusals(host, session, served).reported()
        try:
            with refusals:
                async with links.receiving():
                    try:
                        async with received(tokens, backend.token):
                            yield backend
                    finally:
                        await backend.close()
        finally:
            repeating.cancel()


async def _repeat(revocations: Revocations | None) -> None:
    if revocations is not None:
        await revocations.run()
