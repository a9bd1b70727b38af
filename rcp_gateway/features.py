"""The features of one gateway: decoded, created, run and reloaded."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import msgspec
from prometheus_client.core import Metric

from rcp_gateway.feature_listeners import DurableListener, FeatureListener
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.config.file import GatewayConfig, decode_table
from rcp_kernel.errors import ConfigError, PluginError
from rcp_kernel.features import (
    Accounting,
    Action,
    Call,
    CommandObserver,
    Feature,
    FeatureHost,
    FeatureKind,
    Guard,
    ServiceKey,
    StatusPart,
    SystemResource,
)
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.features.resource import Releases
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_streams.frames import FRAMES, FrameConverter, NoFrames

__all__ = ["ActiveFeature", "Features", "active", "make"]


class ActiveFeature(msgspec.Struct, frozen=True):
    """A feature that the configuration wants, with its table decoded."""

    kind: FeatureKind
    table: Any


def active(
    config: GatewayConfig, kinds: Mapping[str, FeatureKind], source: str
) -> tuple[ActiveFeature, ...]:
    """Decode the table of each feature of a configuration.

    :raises ConfigError: a table does not fit its feature's type, or contradicts the rest.
    """
    found: list[ActiveFeature] = []
    for name, raw in config.active_features.items():
        kind = kinds.get(name)
        if kind is None:  # built in, not installed, and not used
            continue
        table = _table(kind, raw, config, source)
        if kind.check is not None:
            try:
                kind.check(table, config)
            except ConfigError as error:
                raise ConfigError(f"{source}: {error}") from None
        found.append(ActiveFeature(kind, table))
    return tuple(found)


def _table(
    kind: FeatureKind, raw: dict[str, Any] | None, config: GatewayConfig, source: str
) -> Any:
    if kind.table is None:
        return decode_table(raw or {}, kind.config, f"{source}: [features.{kind.name}]: ")
    if raw is not None:
        raise ConfigError(
            f"{source}: [features.{kind.name}] takes no keys; write `{kind.name} = true` or `false` "
            "in [features]"
        )
    return decode_table(kind.table(config), kind.config, f"{source}: ")


class Features:
    """The features of a gateway, in the order of their names."""

    def __init__(self, made: Sequence[tuple[FeatureHealth, Feature]]) -> None:
        self._made = tuple((health.name, feature) for health, feature in made)
        self._health = {health.name: health for health, _ in made}
        listeners = [_listener(health, feature) for health, feature in made]
        self._listeners = [one for one in listeners if one is not None]

    @property
    def resources(self) -> list[SystemResource]:
        """Their resources below `/system/`."""
        return [one for _, feature in self._made for one in feature.resources]

    @property
    def actions(self) -> dict[str, Action]:
        """Their long-running actions, by path."""
        return {one.path: one.action for one in self.resources if one.action is not None}

    @property
    def releases(self) -> dict[str, Releases]:
        """The functions that recognise requests that only release something, by path."""
        return {one.path: one.releases for one in self.resources if one.releases is not None}

    def resources_of(self, name: str) -> list[SystemResource]:
        """The resources of one feature."""
        return [one for own, feature in self._made if own == name for one in feature.resources]

    @property
    def guards(self) -> list[Guard]:
        """Their guards, in no order."""
        return [feature.guard for _, feature in self._made if feature.guard is not None]

    @property
    def observers(self) -> list[tuple[CommandObserver, FeatureHealth]]:
        """The command observers under the current configuration."""
        return [
            (feature.observer, self._health[name])
            for name, feature in self._made
            if feature.observer is not None and (feature.guard is None or feature.guard.active)
        ]

    @property
    def frames(self) -> FrameConverter:
        """The converter of frames."""
        found = (feature.services.get(FRAMES) for _, feature in self._made)
        return next((one for one in found if one is not None), NoFrames())

    @property
    def authenticators(self) -> list[Authenticator]:
        """The authenticators of tokens."""
        found = (feature.authenticator for _, feature in self._made)
        return [one for one in found if one is not None]

    @property
    def event_listeners(self) -> list[FeatureListener]:
        """The listeners for events."""
        return [one for one in self._listeners if one.hears_events]

    @property
    def command_listeners(self) -> list[FeatureListener]:
        """The listeners for steps of commands."""
        return [one for one in self._listeners if one.hears_commands]

    @property
    def recorders(self) -> list[DurableListener]:
        """The features for which replies wait."""
        return [one for one in self._listeners if isinstance(one, DurableListener)]

    @property
    def accounting(self) -> list[Accounting]:
        """The features that count sessions."""
        return [one for _, feature in self._made if (one := feature.accounting) is not None]

    def reader_status(self, session: Session) -> dict[str, Any]:
        """Return the items of `/system/status` about its reader."""
        facts: dict[str, Any] = {}
        for name, feature in self._made:
            if feature.reader_status is not None:
                try:
                    facts |= feature.reader_status(session)
                except Exception as error:
                    self._health[name].failed("reader_status", error)
        return facts

    def metrics(self) -> Iterable[Metric]:
        """Return their metric families for `/metrics`."""
        for name, feature in self._made:
            if feature.metrics is not None:
                try:
                    yield from list(feature.metrics())
                except Exception as error:
                    self._health[name].failed("metrics", error)

    @property
    def services(self) -> list[Mapping[ServiceKey[Any], Any]]:
        """The services of each, by key."""
        return [feature.services for _, feature in self._made]

    def dry_run(self, call: Call) -> dict[str, Any]:
        """Return the items for a dry run."""
        facts: dict[str, Any] = {}
        for _, feature in self._made:
            if feature.dry_run is not None:
                facts.update(feature.dry_run(call))
        return facts

    def foresee(self, session: Session, entry: Entry, value: Any) -> None:
        """Refuse a value that could not be sent later either.

        :raises RcpError: one of them refuses it.
        """
        for _, feature in self._made:
            if feature.foresee is not None:
                feature.foresee(session, entry, value)

    def describe(self, rights: Rights, entry: Entry, /, *, schemas: bool) -> dict[str, Any]:
        """Return the additions to a resource in discovery, for a principal that may command it."""
        facts: dict[str, Any] = {}
        for _, feature in self._made:
            if feature.describe is not None:
                facts.update(feature.describe(rights, entry, schemas=schemas))
        return facts

    def status(self, rights: Rights | None) -> list[StatusPart]:
        """Return their parts of the report of health; one that has failed is degraded."""
        parts: list[StatusPart] = []
        for name, feature in self._made:
            if feature.status is not None:
                try:
                    parts.append(feature.status(rights))
                except Exception as error:
                    self._health[name].failed("status", error)
        states = [_state(health) for health in self._health.values()]
        failed = any(health.fault is not None for health in self._health.values())
        return [*parts, StatusPart({"features": states}, degraded=failed)]

    def session_ended(self, session: Session) -> None:
        """Notify them that a session has ended."""
        for name, feature in self._made:
            if feature.session_ended is not None:
                _tell(self._health[name], feature.session_ended, session)

    def rights_changed(self) -> None:
        """Notify them that the rights of sessions may have changed."""
        for name, feature in self._made:
            if feature.rights_changed is not None:
                _tell(self._health[name], feature.rights_changed)

    def halted(self, paths: frozenset[str], by: str, reason: str) -> None:
        """Notify them that an e-stop has halted the robots of some paths."""
        for name, feature in self._made:
            if feature.halted is not None:
                _tell(self._health[name], feature.halted, paths, by, reason)

    def reconfigure(self, features: Iterable[ActiveFeature]) -> None:
        """Apply the tables of another configuration of the same features."""
        tables = {one.kind.name: one.table for one in features}
        for name, feature in self._made:
            if feature.reconfigure is not None and name in tables:
                feature.reconfigure(tables[name])

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Run all of them while entered."""
        async with AsyncExitStack() as stack:
            for _, feature in self._made:
                if feature.running is not None:
                    await stack.enter_async_context(feature.running())
            yield


def _listener(health: FeatureHealth, feature: Feature) -> FeatureListener | None:
    events, steps, feedback = feature.on_event, feature.on_command, feature.feedback
    if feature.durability is not None:
        return DurableListener(events, steps, health, feature.durability, feedback=feedback)
    if events is None and steps is None:
        return None
    return FeatureListener(events, steps, health, feedback=feedback)


def _state(health: FeatureHealth) -> dict[str, Any]:
    if health.fault is None:
        return {"name": health.name, "state": "ok"}
    facts = {"detail": health.fault, "faults": health.faults}
    return {"name": health.name, "state": "degraded", **facts}


def _tell(health: FeatureHealth, listener: Callable[..., None], *facts: Any) -> None:
    """Call a listener of a feature; an exception counts as a fault of the feature."""
    try:
        listener(*facts)
    except Exception as error:
        health.failed(getattr(listener, "__name__", "listener"), error)


def make(
    features: Iterable[ActiveFeature], host: Callable[[FeatureHealth], FeatureHost]
) -> Features:
    """Create each feature with its own host."""
    found = [(one, FeatureHealth(one.kind.name)) for one in features]
    made = [(health, one.kind.make(one.table, host(health))) for one, health in found]
    for health, feature in made:
        _check_bases(health.name, feature)
    return Features(made)


def _check_bases(name: str, feature: Feature) -> None:
    """Check that a guard or observer has what the kernel reads of each, as those that derive do.

    :raises PluginError: it was written before the attribute existed, and does not derive from its base.
    """
    parts = ((feature.guard, Guard, "idle"), (feature.observer, CommandObserver, "writes_only"))
    for part, base, attribute in parts:
        if part is not None and not hasattr(part, attribute):
            raise PluginError(
                f"{type(part).__name__} of the feature '{name}' has no `{attribute}`; "
                f"derive it from `rcp_kernel.features.{base.__name__}`"
            )
