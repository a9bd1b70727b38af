"""A feature: what a plugin adds to the gateway itself, declared as one record.

A backend adds a robot, a transport or an adapter adds clients; a feature adds resources below
`/system/`, a rule that commands must pass, or a way to prove who one is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Any

import msgspec
from prometheus_client.core import Metric

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.contract.events import Hear
from rcp_kernel.features.commands import CommandObserver
from rcp_kernel.features.description import Describe
from rcp_kernel.features.durability import Durability
from rcp_kernel.features.guard import Call, Guard
from rcp_kernel.features.host import FeatureHost
from rcp_kernel.features.resource import SystemResource
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.features.status import StatusPart
from rcp_kernel.sessions.accounting import Accounting
from rcp_kernel.sessions.command import CommandListener
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry

__all__ = ["Feature", "FeatureKind"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One feature of one gateway. Everything is optional."""

    resources: tuple[SystemResource, ...] = ()
    """What it shows and does below `/system/`."""
    guard: Guard | None = None
    """What it refuses."""
    dry_run: Callable[[Call], Mapping[str, Any]] | None = None
    """Returns what a dry run should tell of a call; items that are None are left out."""
    observer: CommandObserver | None = None
    """Hears what becomes of commands; of a feature whose guard is not active, nothing."""
    foresee: Callable[[Session, Entry, Any], None] | None = None
    """Refuses a value that could not pass at any later moment either; asked when a plan is checked,
    long before the step of which it is."""
    describe: Describe | None = None
    """Returns what discovery adds to a resource for somebody who may command it."""
    status: Callable[[Rights | None], StatusPart] | None = None
    """Returns a part of `/system/status` for somebody, or for everybody (None)."""
    authenticator: Authenticator | None = None
    """Finds the principal of a bearer token."""
    on_event: Hear | None = None
    """Hears of writes, refusals, logins, e-stops, stops by the gateway itself, starts and reloads."""
    on_command: CommandListener | None = None
    """Hears each step of each command, plans included, before any client does."""
    durability: Durability | None = None
    """Has replies wait until what they confirm is kept, and refuses what could not be."""
    accounting: Accounting | None = None
    """Counts sessions with their requests, subscriptions and commands, and may refuse more of them."""
    reader_status: Callable[[Session], Mapping[str, Any]] | None = None
    """Returns what `/system/status` tells a reader about itself, by names of the feature's own."""
    metrics: Callable[[], Iterable[Metric]] | None = None
    """Returns families for `/metrics`, at each scrape."""
    services: Mapping[ServiceKey[Any], Any] = field(default_factory=dict[ServiceKey[Any], Any])
    """What it offers to adapters and other parts of the gateway, by key."""
    reconfigure: Callable[[Any], None] | None = None
    """Takes over the table of a reloaded configuration, at once."""
    session_ended: Callable[[Session], None] | None = None
    """Hears of each session that ends: it will not be resumed, unless the gateway is closing."""
    rights_changed: Callable[[], None] | None = None
    """Hears that sessions may have other rights than before: by a reload, or another token."""
    halted: Callable[[frozenset[str], str, str], None] | None = None
    """Hears of the paths whose robots an e-stop has halted, by whom, and why; what ran on them has
    been ended."""
    running: Callable[[], AbstractAsyncContextManager[None]] | None = None
    """Its life: entered before any backend is opened, left after the last one is closed."""


class FeatureKind(msgspec.Struct, frozen=True):
    """A feature that can be configured; offered by the hook `rcp_features`.

    `make(table, host)` is called while the gateway is built: it must not do I/O. What runs goes into
    `Feature.running`.
    """

    name: str
    """Its table in the configuration: `[features.<name>]`."""
    config: Any
    """The type of its table."""
    make: Callable[[Any, FeatureHost], Feature]
    description: str = ""
    needs: tuple[str, ...] = ()
    """As of `BackendKind`; a feature that lacks one is an error at the start."""
    table: Callable[[GatewayConfig], Any] | None = None
    """Takes its table from elsewhere in the configuration, for features whose keys are there: a value
    of the type `config`, or what is decoded by it."""
    check: Callable[[Any, GatewayConfig], None] | None = None
    """Raise `ConfigError` for what this table and the rest of the configuration must not say
    together; asked by `rcpd check` too."""
