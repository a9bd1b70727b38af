"""A feature: a plugin's extension of the gateway itself, declared as one record.

Backends add robots, transports and adapters add clients; a feature adds resources below `/system/`,
rules that commands must pass, or an authentication method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import msgspec
from prometheus_client.core import Metric

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import Rule
from rcp_kernel.contract.events import EventHandler
from rcp_kernel.features.guard import Call, Guard
from rcp_kernel.features.host import FeatureHost
from rcp_kernel.features.observer import CommandObserver
from rcp_kernel.features.resource import SystemResource
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.sessions.accounting import Accounting
from rcp_kernel.sessions.command import CommandListener
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Reply

__all__ = ["Describe", "Durability", "Feature", "FeatureKind", "StatusPart"]


class StatusPart(NamedTuple):
    """A part of the health report."""

    facts: Mapping[str, Any]
    """Items of the report, by the feature's own names."""
    degraded: bool = False
    """Whether something is wrong, so that the gateway as a whole is not `ok`."""


class Describe(Protocol):
    """Describes which commands a principal may send to a resource."""

    def __call__(self, rights: Rights, entry: Entry, /, *, schemas: bool) -> Mapping[str, Any]:
        """Return items for the description; `schemas` requests full schemas."""
        ...


class Durability(Protocol):
    """Delays replies to writes, commands and recorded refusals until their records are stored.

    Commands to robots are not delayed, and neither are reads and subscriptions.
    """

    def check(self) -> None:
        """Refuse a write or command whose record could not be stored; not called for holds.

        :raises QueueFull: the record could not be stored.
        """
        ...

    def send_when_stored(self, send: Answer, until: float, reply: Reply) -> None:
        """Send a reply now, or once all records so far are stored.

        `until` is the event loop time at which the client stops waiting.
        """
        ...

    def send_estop_when_stored(self, send: Answer, reply: Reply) -> None:
        """Send the reply to an e-stop as `send_when_stored`, but soon in any case."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One feature of one gateway. Every field is optional."""

    resources: tuple[SystemResource, ...] = ()
    """Its resources below `/system/`."""
    guard: Guard | None = None
    """Refuses commands."""
    dry_run: Callable[[Call], Mapping[str, Any]] | None = None
    """Returns items to add to a dry run of a call; None values are left out."""
    observer: CommandObserver | None = None
    """Receives command events, but only while the guard, if any, is active."""
    foresee: Callable[[Session, Entry, Any], None] | None = None
    """Refuses a value that could not pass at any later time either; called when a plan is checked,
    long before the step is run."""
    describe: Describe | None = None
    """Returns additions to the description of a resource, for a principal that may command it."""
    status: Callable[[Rights | None], StatusPart] | None = None
    """Returns a part of `/system/status` for a principal, or for everyone (None)."""
    authenticator: Authenticator | None = None
    """Returns the principal of a bearer token."""
    on_event: EventHandler | None = None
    """Receives writes, refusals, logins, e-stops, stops by the gateway, starts and reloads."""
    on_command: CommandListener | None = None
    """Receives each step of each command, including plans, before any client does. An object with an
    attribute `idle` is not called while that is true."""
    feedback: bool = True
    """Whether `on_command` also receives feedback, the most frequent step."""
    durability: Durability | None = None
    """Delays replies until their records are stored, and refuses commands that could not be
    recorded."""
    accounting: Accounting | None = None
    """Counts sessions with their requests, subscriptions and commands, and may refuse more of
    them."""
    reader_status: Callable[[Session], Mapping[str, Any]] | None = None
    """Returns items of `/system/status` about its reader, by the feature's own names."""
    metrics: Callable[[], Iterable[Metric]] | None = None
    """Returns metric families for `/metrics`, at each scrape."""
    services: Mapping[ServiceKey[Any], Any] = field(default_factory=dict[ServiceKey[Any], Any])
    """Services for adapters and other parts of the gateway, by key."""
    reconfigure: Callable[[Any], None] | None = None
    """Applies the table of a reloaded configuration immediately."""
    session_ended: Callable[[Session], None] | None = None
    """Called for each session that ends and cannot be resumed, unless the gateway is closing."""
    rights_changed: Callable[[], None] | None = None
    """Called when the rights of sessions may have changed, by a reload or another token."""
    halted: Callable[[frozenset[str], str, str], None] | None = None
    """Called with the paths whose robots an e-stop has halted, by whom, and why; their commands have
    already been ended."""
    running: Callable[[], AbstractAsyncContextManager[None]] | None = None
    """Entered before any backend is opened, left after the last one is closed."""


class FeatureKind(msgspec.Struct, frozen=True):
    """A configurable feature, registered by the hook `rcp_features`.

    `make(table, host)` is called while the gateway is built and must not do I/O; background work
    belongs into `Feature.running`.
    """

    name: str
    """Name of its table in the configuration: `[features.<name>]`."""
    config: Any
    """The type of its table."""
    make: Callable[[Any, FeatureHost], Feature]
    description: str = ""
    needs: tuple[str, ...] = ()
    """As for `BackendKind`; a missing requirement is an error at the start."""
    table: Callable[[GatewayConfig], Any] | None = None
    """Returns the table from elsewhere in the configuration: a value of the type `config`, or data to
    decode."""
    check: Callable[[Any, GatewayConfig], None] | None = None
    """Checks this table against the rest of the configuration and raises `ConfigError`; also called by
    `rcpd check`."""
    grants: Mapping[str, tuple[Rule, ...]] = {}
    """Rules that the built-in roles `viewer`, `hub`, `operator` and `agent` have with the feature."""
