"""The health report: what `/system/status`, `/readyz` and `/metrics` say."""

from __future__ import annotations

import asyncio
import platform
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from operator import attrgetter
from typing import Any

import psutil
from prometheus_client.core import Metric

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.sights import Hidden, Sights
from rcp_kernel.access.visibility import Visibility, names_in
from rcp_kernel.app.log import Recent
from rcp_kernel.app.supervisor import WIRE_STATE, BackendSupervisor
from rcp_kernel.clock import iso, now
from rcp_kernel.contract.metrics import Histogram, Metrics, RequestCounts, counter, gauge, histogram
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.features import StatusPart
from rcp_kernel.model import tenant_of
from rcp_kernel.requests.journal import CommandJournal
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.spi import RobotLink
from rcp_kernel.streams.hub import Hub
from rcp_kernel.streams.outbound import Outbound
from rcp_kernel.streams.subscription import Subscription
from rcp_kernel.tree.entry import StopGroup, is_system
from rcp_kernel.tree.registry import Registry
from rcp_store.store import Store

__all__ = ["StatusReport"]

_LAG_PERIOD = 0.5  # s
_PART = 50  # resources whose metrics are written per step
_LINK_COUNTS: tuple[tuple[str, str, Callable[[RobotLink], int]], ...] = (
    ("rcp_robot_link_sent_bytes", "Sent to the gateway of a robot.", attrgetter("sent")),
    ("rcp_robot_link_received_bytes", "Received from it.", attrgetter("received")),
    ("rcp_robot_links_lost", "Links with it that ended by a loss.", attrgetter("lost")),
)


class StatusReport:
    """Looks at the whole gateway and says how it is."""

    def __init__(
        self,
        supervisors: Sequence[BackendSupervisor],
        recent: Recent,
        *,
        registry: Registry,
        hub: Hub,
        sights: Sights,
        visibility: Visibility,
        identities: Identities,
        sessions: Sessions,
        outbound: Outbound,
        journal: CommandJournal,
        counts: RequestCounts,
        features: Callable[[Rights | None], Iterable[StatusPart]],
        store: Store,
        metrics: Callable[[], Iterable[Metric]],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._supervisors = supervisors
        self._recent = recent
        self._registry = registry
        self._hub = hub
        self.sights = sights
        self._visibility = visibility
        self._identities = identities
        self._sessions = sessions
        self._outbound = outbound
        self._feature_metrics = metrics
        self._journal = journal
        self._counts = counts
        self._features = features
        self._store = store
        self._loop = loop
        self.transports: list[dict[str, Any]] = []
        self.adapters: list[dict[str, Any]] = []
        self.metrics = Metrics()
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._started = now()
        self._lag = Histogram()
        self._lag_last = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._expected = 0.0

    def start(self) -> None:
        """Begin to measure how late the event loop is."""
        self._expected = self._loop.time() + _LAG_PERIOD
        self._timer = self._loop.call_at(self._expected, self._measure)

    def _measure(self) -> None:
        self._lag_last = max(0.0, self._loop.time() - self._expected)
        self._lag.observe(self._lag_last)
        self.start()

    def stop(self) -> None:
        """Stop measuring."""
        if self._timer is not None:
            self._timer.cancel()

    def ready(self) -> tuple[bool, dict[str, str]]:
        """Tell whether every backend is ready, and each one's state."""
        states = {
            supervisor.name: WIRE_STATE.get(supervisor.state, "down")
            for supervisor in self._supervisors
        }
        return all(state in ("ready", "degraded") for state in states.values()), states

    def absent_adapters(self) -> dict[str, str]:
        """Return the adapters that are installed and do not run, each with the reason and remedy."""
        return {
            one["name"]: one["detail"] for one in self.adapters if one["state"] in ("off", "down")
        }

    def plain(self, rights: Rights | None = None) -> dict[str, Any]:
        """Return the report, limited to the tenants of a principal, or all of it."""
        every = rights is None or "*" in rights.tenants
        tenants = ("*",) if rights is None else rights.tenants
        supervisors = [s for s in self._supervisors if every or s.tenant in tenants]
        robots = [self._robot(supervisor, rights) for supervisor in supervisors]
        states = [robot["state"] for robot in robots]
        adapters = [*self.adapters, *self._identities.facts]
        parts = [*self.transports, *adapters]
        broken = any(part.get("state") == "down" for part in parts)
        broken = broken or any(robot["robots"] for robot in robots)
        broken = broken or (self._store.trouble or self._store.damage) is not None
        sections = list(self._features(rights))
        broken = broken or any(part.degraded for part in sections)
        worst = "ok" if all(s == "ready" for s in states) and not broken else "degraded"
        if states and all(state == "down" for state in states):
            worst = "down"
        sessions = self._sessions_of(tenants)
        report = {
            "state": worst,
            "version": gateway_version(),
            "uptime": round(time.monotonic() - self.metrics.started, 3),
            "started": iso(self._started),
            "backends": robots,
            "transports": self.transports if every else [_part(one) for one in self.transports],
            "adapters": adapters if every else [_part(one) for one in self.adapters],
            "sessions": len(sessions),
            "subscriptions": sum(len(session.subscriptions) for session in sessions),
            "resources": self._count_resources(rights),
            "commands": self._count_commands(rights),
            "queues": self._queues(tenants),
            "warnings": [r for r in self._recent.records if self.concerns(r, rights)],
        }
        for part in sections:
            report |= part.facts
        if every:
            report["process"] = self._process_facts()
            report["host"] = {
                "name": platform.node(),
                "platform": platform.platform(),
                "python": platform.python_version(),
                "cpus": psutil.cpu_count() or 0,
            }
        return report

    def _count_resources(self, rights: Rights | None) -> int:
        if rights is None:
            return len(self._registry.entries)
        return self.sights.look(rights).visible

    def _hides(self, supervisor: BackendSupervisor, rights: Rights) -> Hidden:
        return self.sights.look(rights).hides(supervisor.tenant, supervisor.name)

    def _mentions_hidden(self, supervisor: BackendSupervisor, rights: Rights, text: str) -> bool:
        sight = self.sights.look(rights)
        return sight.mentions_hidden(supervisor.tenant, supervisor.name, text)

    def _robot(self, supervisor: BackendSupervisor, rights: Rights | None) -> dict[str, Any]:
        """Describe a backend without anything hidden from the principal."""
        facts = supervisor.plain()
        facts["robots"] = {
            unit.robot: {
                "state": unit.state,
                "since": iso(unit.since),
                "detail": self._shown(supervisor, rights, unit.detail),
            }
            for unit in supervisor.unready
            if rights is None or self._sees(rights, unit)
        }
        if rights is None:
            return facts
        facts["resources"] -= self._hides(supervisor, rights).count
        for key in ("detail", "last_error"):
            facts[key] = self._shown(supervisor, rights, facts[key])
        return facts

    def _sees(self, rights: Rights, robot: StopGroup) -> bool:
        if not robot.own:  # it was never reached
            return self._visibility.sees_whole(rights, robot.tenant)
        return any(rights.mask(entry.path) for entry in robot.own.values())

    def _shown(
        self, supervisor: BackendSupervisor, rights: Rights | None, text: str | None
    ) -> str | None:
        """Return a text of a backend, unless it names something hidden from the principal."""
        if text is None or rights is None:
            return text
        hidden = rights.hides(text) or self._mentions_hidden(supervisor, rights, text)
        return "see the log of the gateway" if hidden else text

    def concerns(self, record: dict[str, Any], rights: Rights | None) -> bool:
        """Return whether a log record is of a principal's tenants and names nothing hidden."""
        if rights is None:
            return True
        if "*" not in rights.tenants and self.tenant_of(record) not in rights.tenants:
            return False
        facts = record["facts"]
        texts = [record["message"], *(text for text in facts.values() if isinstance(text, str))]
        if self._visibility.mentions_hidden(rights, self.tenant_of(record), names_in(texts)):
            return False
        supervisor = next((s for s in self._supervisors if s.name == _backend(facts)), None)
        return supervisor is None or not any(
            self._mentions_hidden(supervisor, rights, text) for text in texts
        )

    def tenant_of(self, record: dict[str, Any]) -> str | None:
        """Return the tenant that a log record is about; None: it is the gateway's own."""
        facts = record["facts"]
        path = facts.get("path")
        if isinstance(path, str) and path.startswith("/tenant/"):
            return tenant_of(path)
        name = _backend(facts)
        return next(
            (supervisor.tenant for supervisor in self._supervisors if supervisor.name == name), None
        )

    def _sessions_of(self, tenants: tuple[str, ...]) -> list[Session]:
        known = self._sessions.known.values()
        return [s for s in known if "*" in tenants or s.tenant in tenants]

    def _count_commands(self, rights: Rights | None) -> dict[str, int]:
        commands = self._journal
        running = [c.status for c in commands.running.values() if self._is_counted(rights, c.path)]
        ended: dict[str, int] = {}
        for (path, status), count in commands.counts.items():
            if self._is_counted(rights, path):
                ended[status] = ended.get(status, 0) + count
        queued = running.count("pending")
        return {
            "running": len(running) - queued,
            "queued": queued,
            "completed": ended.get("completed", 0),
            "failed": ended.get("failed", 0) + ended.get("rejected", 0),
            "cancelled": ended.get("cancelled", 0),
        }

    def _is_counted(self, rights: Rights | None, path: str) -> bool:
        """Tell whether commands on a path count; the gateway's own for who sees all they may touch."""
        if rights is None:
            return True
        whole = not is_system(path) or self._visibility.sees_whole(rights, None)
        return whole and bool(rights.mask(path))

    def _process_facts(self) -> dict[str, Any]:
        process = self._process
        with process.oneshot():
            return {
                "cpu": process.cpu_percent(),
                "rss": process.memory_info().rss,
                "threads": process.num_threads(),
                "open_files": process.num_fds() if hasattr(process, "num_fds") else 0,
            }

    def _queues(self, tenants: tuple[str, ...]) -> dict[str, Any]:
        sessions = self._sessions_of(tenants)
        boxes = {s.id[:8]: s.connection.outbox for s in sessions if s.connection is not None}
        waiting = {id_: box.depth for id_, box in boxes.items()}
        if "*" in tenants:
            dropped = sum(self._hub.dropped.values()) + _conflated(self._hub.subscriptions)
        else:
            dropped = _conflated(sub for s in sessions for sub in s.subscriptions.values())
        return {
            "depth": sum(waiting.values()),
            "high_water": max((box.high_water for box in boxes.values()), default=0),
            "dropped": dropped,
            "by_session": {id_: depth for id_, depth in waiting.items() if depth},
        }

    # -- Prometheus ----------------------------------------------------------------------------

    def exposition(self, rights: Rights) -> Generator[None, None, bytes]:
        """Write the exposition for a principal, in steps."""
        return self.metrics.exposition(self._families(rights))

    def _families(self, rights: Rights) -> Iterable[Metric]:
        commands = self._journal
        facts = {"version": gateway_version(), "python": platform.python_version()}
        yield gauge("rcp_build_info", "What runs here.", tuple(facts), [(list(facts.values()), 1)])
        up = time.monotonic() - self.metrics.started
        yield gauge("rcp_uptime_seconds", "Since the start.", (), [([], up)])
        yield gauge(
            "rcp_backend_up",
            "Whether a backend is ready.",
            ("backend", "tenant"),
            [([s.name, s.tenant], float(s.backend is not None)) for s in self._supervisors],
        )
        yield from self._robot_families(rights)
        yield counter(
            "rcp_requests",
            "Requests by their outcome.",
            ("transport", "type", "code"),
            [(list(key), count) for key, count in self._counts.outcomes.items()],
        )
        yield histogram(
            "rcp_request_seconds", "From request to final reply.", (), [([], self._counts.seconds)]
        )
        yield counter(
            "rcp_samples",
            "Samples that a backend published.",
            ("backend",),
            [([s.name], s.samples) for s in self._supervisors],
        )
        yield counter("rcp_updates", "Updates sent.", ("transport",), self._updates())
        dropped = {**self._hub.dropped}
        dropped["conflated"] += _conflated(self._hub.subscriptions)
        yield counter(
            "rcp_dropped",
            "Samples not delivered.",
            ("reason",),
            [([reason], count) for reason, count in dropped.items()],
        )
        yield from self._gauges()
        outbound = self._outbound
        yield counter(
            "rcp_queue_full",
            "What was done because too much waited for clients.",
            ("action",),
            [(["refused"], outbound.refused), (["closed"], outbound.cut)],
        )
        yield counter(
            "rcp_commands",
            "Commands by final status.",
            ("status",),
            _by_status(commands.counts),
        )
        yield histogram(
            "rcp_command_seconds", "Of finished commands.", (), [([], commands.seconds)]
        )
        yield from self._feature_metrics()
        entries = list(self._registry.entries.values())
        for begin in range(0, max(1, len(entries)), _PART):
            part = entries[begin : begin + _PART]
            yield gauge(
                "rcp_resource_age_seconds",
                "Age of the latest sample of paths with a deadline.",
                ("path",),
                [
                    ([entry.path], entry.age)
                    for entry in part
                    if entry.deadline is not None
                    and entry.age is not None
                    and rights.mask(entry.path)
                ],
            )

    def _robot_families(self, rights: Rights) -> Iterable[Metric]:
        labels = ("backend", "tenant", "robot")
        robots = [(s, unit) for s in self._supervisors for unit in s.robots]
        links: list[tuple[list[str], RobotLink]] = []
        for begin in range(0, max(1, len(robots)), _PART):
            ups: list[tuple[list[str], float]] = []
            for supervisor, unit in robots[begin : begin + _PART]:
                if not self._sees(rights, unit):
                    continue
                values = [supervisor.name, supervisor.tenant, str(unit.robot)]
                ups.append((values, float(_is_up(unit))))
                if (link := _link_of(supervisor, unit)) is not None:
                    links.append((values, link))
            text = "Whether one of several robots of a backend is ready."
            yield gauge("rcp_robot_up", text, labels, ups)
        parts = [links[begin : begin + _PART] for begin in range(0, max(1, len(links)), _PART)]
        for part in parts:
            yield gauge(
                "rcp_robot_link_latency_seconds",
                "Last round trip to the gateway of a robot.",
                labels,
                [(values, one.latency) for values, one in part if one.latency is not None],
            )
        for name, text, count in _LINK_COUNTS:
            for part in parts:
                yield counter(name, text, labels, [(values, count(one)) for values, one in part])

    def _gauges(self) -> Iterable[Metric]:
        queues = self._queues(("*",))
        for name, text, value in (
            (
                "rcp_store_degraded",
                "Whether the store is damaged, gone, or cannot be written.",
                (self._store.trouble or self._store.damage) is not None,
            ),
            ("rcp_sessions", "Sessions held.", len(self._sessions.known)),
            ("rcp_subscriptions", "Subscriptions held.", len(self._hub.subscriptions)),
            ("rcp_queue_depth", "Messages waiting for clients.", queues["depth"]),
            (
                "rcp_queue_bytes",
                "Bytes waiting for clients, but for 64 KiB of each.",
                self._outbound.total,
            ),
            ("rcp_event_loop_lag_seconds", "How late the event loop was.", self._lag_last),
        ):
            yield gauge(name, text, (), [([], float(value))])

    def _updates(self) -> list[tuple[list[str], float]]:
        sums = dict(self._sessions.updates)
        for session in self._sessions.known.values():
            if session.connection is not None:
                name = session.transport
                sums[name] = sums.get(name, 0) + session.connection.outbox.updates
        return [([name], count) for name, count in sums.items()]


def _link_of(supervisor: BackendSupervisor, unit: StopGroup) -> RobotLink | None:
    """Return what the link with a robot's own gateway carries, if it has one and its backend can."""
    backend = supervisor.backend
    if backend is None or unit.robot is None or not supervisor.has_gateways:
        return None
    try:
        return backend.robot_link(unit.robot)
    except Exception as error:  # a bad one must not hide the metrics of all others
        supervisor.fault(f"robot_link: {error!r}")
        return None


def _is_up(robot: StopGroup) -> bool:
    return robot.availability in ("ready", "degraded")


def _conflated(subscriptions: Iterable[Subscription]) -> int:
    return sum(subscription.skipped for subscription in subscriptions)


def _part(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the facts of a transport or adapter without those of other tenants."""
    return {key: facts[key] for key in ("name", "state") if key in facts}


def _by_status(counts: dict[tuple[str, str], int]) -> list[tuple[list[str], float]]:
    sums: dict[str, int] = {}
    for (_, status), count in counts.items():
        sums[status] = sums.get(status, 0) + count
    return [([status], count) for status, count in sums.items()]


def _backend(facts: dict[str, Any]) -> str:
    """Return the backend that a log record names; for one of its robots, the part before it."""
    return str(facts.get("backend", "")).partition("/")[0]
