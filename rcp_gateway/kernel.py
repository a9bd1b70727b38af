"""The parts of a gateway, for who runs it: the application, and tests."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rcp_gateway.client_api import ClientApi
from rcp_gateway.exposition import Exposition
from rcp_gateway.features import ActiveFeature, Features
from rcp_gateway.status import StatusReport
from rcp_gateway.supervisor import BackendSupervisor
from rcp_gateway.system import System
from rcp_kernel.access.acl import Rules
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.access.identities import Identities
from rcp_kernel.config.file import BackendConfig, GatewayConfig
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.events import EventBus
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.features.commands import CommandEvents
from rcp_kernel.safety.safety import Deadman
from rcp_kernel.safety.stop import StopController
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.tree.registry import Registry
from rcp_requests.admission import Admission
from rcp_requests.commands import Commands
from rcp_requests.journal import CommandJournal
from rcp_store.store import Store
from rcp_streams.hub import Hub

__all__ = ["Kernel"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kernel:
    """The composed parts. No part holds this record."""

    settings: Settings
    shutdown: Shutdown
    loop: asyncio.AbstractEventLoop
    registry: Registry
    hub: Hub
    conditions: Conditions
    rules: Rules
    counts: RequestCounts
    store: Store
    event_bus: EventBus
    journal: CommandJournal
    events: CommandEvents
    deadman: Deadman
    commands: Commands
    stops: StopController
    identities: Identities
    outbound: Outbound
    resume: SessionResume
    sessions: Sessions
    status: StatusReport
    exposition: Exposition
    system: System
    features: Features
    admission: Admission
    supervisors: list[BackendSupervisor]
    supervise: Callable[[BackendConfig], BackendSupervisor]
    """Makes the supervisor of a backend from its table of the configuration."""
    client_api: ClientApi

    @property
    def moving(self) -> bool:
        """Whether a robot is driven, or carries something out."""
        return self.deadman.driving or bool(self.commands.running)

    def reconfigure(self, config: GatewayConfig, features: Sequence[ActiveFeature] = ()) -> None:
        """Apply the rules, keys and limits of another configuration, to open sessions too.

        A feature that is not among `features` keeps its table.
        """
        self.settings.replace(config)
        self.outbound.configure(config.limits)
        self.hub.pattern_value = config.limits.pattern_value
        self.rules.configure(config.roles)
        self.identities.reconfigure(config)
        self.features.reconfigure(features)
        self.events.configure(self.features.observers)
        self.admission.configure()
        self.sessions.review()

    async def close(self) -> None:
        """Cancel what runs and stop all streams; the backends are still there."""
        self.shutdown.begin()
        self.stops.close()
        self.sessions.relief.close()
        self.outbound.close()
        self.deadman.close()
        await self.commands.close()
        await self.hub.close()
