"""The health report: the content of `/system/status` and `/readyz`.

It shows states and decides none: `BackendSupervisor` says whether a backend is down.
"""

from __future__ import annotations

import asyncio
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import psutil

from rcp_gateway.log import Recent
from rcp_gateway.supervisor import BackendSupervisor
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.tree_views import Hidden, TreeViews
from rcp_kernel.access.visibility import Visibility, names_in
from rcp_kernel.clock import iso, now
from rcp_kernel.contract.paths import is_system
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.features import StatusPart
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.tree.entry import RobotUnit
from rcp_kernel.tree.registry import Registry
from rcp_requests.journal import CommandJournal
from rcp_store.store import Store
from rcp_streams.hub import Hub
from rcp_streams.subscription import Subscription, subscriptions_of

__all__ = ["StatusReport", "count_skipped"]

_LAG_PERIOD = 0.5  # s


class StatusReport:
    """Writes the health report, limited to what a principal may see."""

    def __init__(
        self,
        supervisors: Sequence[BackendSupervisor],
        recent: Recent,
        *,
        registry: Registry,
        hub: Hub,
        tree_views: TreeViews,
        visibility: Visibility,
        identities: Identities,
        sessions: Sessions,
        outbound: Outbound,
        journal: CommandJournal,
        features: Callable[[Rights | None], Iterable[StatusPart]],
        store: Store,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._supervisors = supervisors
        self._recent = recent
        self._registry = registry
        self._hub = hub
        self.tree_views = tree_views
        self._visibility = visibility
        self._identities = identities
        self._sessions = sessions
        self._outbound = outbound
        self._journal = journal
        self._features = features
        self._store = store
        self._loop = loop
        self.transports: list[dict[str, Any]] = []
        self.adapters: list[dict[str, Any]] = []
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._started = now()
        self._began = time.monotonic()
        self.lag = 0.0
        """How late the event loop was last, in s."""
        self._timer: asyncio.TimerHandle | None = None
        self._expected = 0.0

    @property
    def uptime(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._began

    def start(self) -> None:
        """Start to measure how late the event loop is."""
        self._expected = self._loop.time() + _LAG_PERIOD
        self._timer = self._loop.call_at(self._expected, self._measure)

    def _measure(self) -> None:
        self.lag = max(0.0, self._loop.time() - self._expected)
        self.start()

    def stop(self) -> None:
        """Stop measuring."""
        if self._timer is not None:
            self._timer.cancel()

    def ready(self) -> tuple[bool, dict[str, str]]:
        """Return whether every backend is ready, and each one's state."""
        states: dict[str, str] = {one.name: one.availability for one in self._supervisors}
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
        backends = [self._describe_backend(supervisor, rights) for supervisor in supervisors]
        states = [backend["state"] for backend in backends]
        adapters = [*self.adapters, *self._identities.facts]
        parts = [*self.transports, *adapters]
        broken = any(part.get("state") == "down" for part in parts)
        broken = broken or any(backend["robots"] for backend in backends)
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
            "uptime": round(self.uptime, 3),
            "started": iso(self._started),
            "backends": backends,
            "transports": self.transports if every else [_part(one) for one in self.transports],
            "adapters": adapters if every else [_part(one) for one in self.adapters],
            "sessions": len(sessions),
            "subscriptions": sum(len(session.subscriptions) for session in sessions),
            "resources": self._count_resources(rights),
            "commands": self._count_commands(rights),
            "queues": self.queues(tenants),
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
        return self.tree_views.look(rights).visible

    def _hides(self, supervisor: BackendSupervisor, rights: Rights) -> Hidden:
        return self.tree_views.look(rights).hidden_of(supervisor.tenant, supervisor.name)

    def _mentions_hidden(self, supervisor: BackendSupervisor, rights: Rights, text: str) -> bool:
        view = self.tree_views.look(rights)
        return view.mentions_hidden(supervisor.tenant, supervisor.name, text)

    def _describe_backend(
        self, supervisor: BackendSupervisor, rights: Rights | None
    ) -> dict[str, Any]:
        """Describe a backend without anything hidden from the principal."""
        facts = supervisor.plain()
        facts["robots"] = {
            unit.robot: {
                "state": unit.state,
                "since": iso(unit.since),
                "detail": self._shown(supervisor, rights, unit.detail),
            }
            for unit in supervisor.unready
            if rights is None or self.sees(rights, unit)
        }
        if rights is None:
            return facts
        facts["resources"] -= self._hides(supervisor, rights).count
        for key in ("detail", "last_error"):
            facts[key] = self._shown(supervisor, rights, facts[key])
        return facts

    def sees(self, rights: Rights, robot: RobotUnit) -> bool:
        """Return whether a principal may know of a robot."""
        if not robot.own:  # it has never been connected
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
        """Return whether a log record belongs to a principal's tenants and names nothing hidden."""
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
        """Return the tenant that a log record is about; None: the gateway itself."""
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
        """Return whether a principal's report counts commands on a path.

        Those of the gateway itself are counted only for principals that see everything.
        """
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

    def queues(self, tenants: tuple[str, ...]) -> dict[str, Any]:
        """Return the number of messages queued for the clients of some tenants; `*` means all of them."""
        sessions = self._sessions_of(tenants)
        boxes = {s.id[:8]: s.connection.outbox for s in sessions if s.connection is not None}
        waiting = {id_: box.depth for id_, box in boxes.items()}
        if "*" in tenants:
            dropped = sum(self._hub.dropped.values()) + count_skipped(self._hub.subscriptions)
        else:
            dropped = count_skipped(sub for s in sessions for sub in subscriptions_of(s).values())
        return {
            "depth": sum(waiting.values()),
            "high_water": max((box.high_water for box in boxes.values()), default=0),
            "dropped": dropped,
            "by_session": {id_: depth for id_, depth in waiting.items() if depth},
        }


def count_skipped(subscriptions: Iterable[Subscription]) -> int:
    """Return how many samples subscriptions have skipped."""
    return sum(subscription.skipped for subscription in subscriptions)


def _part(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the facts of a transport or adapter without those of other tenants."""
    return {key: facts[key] for key in ("name", "state") if key in facts}


def _backend(facts: dict[str, Any]) -> str:
    """Return the backend that a log record names; for one of its robots, the part before it."""
    return str(facts.get("backend", "")).partition("/")[0]
