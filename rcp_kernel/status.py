"""The health report: what `/system/status`, `/readyz` and `/metrics` say."""

from __future__ import annotations

import asyncio
import platform
import time
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import psutil
from prometheus_client.core import Metric

from rcp_kernel.clock import iso, now
from rcp_kernel.gateway import Gateway
from rcp_kernel.log import Recent
from rcp_kernel.metrics import Histogram, Metrics, counter, gauge, histogram
from rcp_kernel.supervisor import WIRE_STATE, Slot

__all__ = ["StatusReport", "gateway_version"]

_LAG_PERIOD = 0.5  # s


def gateway_version() -> str:
    """Return the installed version of the distribution."""
    try:
        return version("rcp-gateway")
    except PackageNotFoundError:
        return "0"


class StatusReport:
    """Looks at the whole gateway and says how it is."""

    def __init__(self, gateway: Gateway, slots: list[Slot], recent: Recent) -> None:
        self._gateway = gateway
        self._slots = slots
        self._recent = recent
        self.transports: list[dict[str, Any]] = []
        self.adapters: list[dict[str, Any]] = []
        self.metrics = Metrics(self._families)
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._started = now()
        self._lag = Histogram()
        self._lag_last = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._expected = 0.0

    def start(self) -> None:
        """Begin to measure how late the event loop is."""
        self._expected = self._gateway.loop.time() + _LAG_PERIOD
        self._timer = self._gateway.loop.call_at(self._expected, self._measure)

    def _measure(self) -> None:
        self._lag_last = max(0.0, self._gateway.loop.time() - self._expected)
        self._lag.observe(self._lag_last)
        self.start()

    def stop(self) -> None:
        """Stop measuring."""
        if self._timer is not None:
            self._timer.cancel()

    def ready(self) -> tuple[bool, dict[str, str]]:
        """Tell whether every backend is ready, and each one's state."""
        states = {slot.name: WIRE_STATE.get(slot.state, "down") for slot in self._slots}
        return all(state in ("ready", "degraded") for state in states.values()), states

    def plain(self, tenants: tuple[str, ...] = ("*",)) -> dict[str, Any]:
        """Write the report, with the backends of the given tenants only."""
        gateway = self._gateway
        slots = [s for s in self._slots if "*" in tenants or s.tenant in tenants]
        states = [WIRE_STATE.get(slot.state, "down") for slot in slots]
        parts = [*self.transports, *self.adapters]
        broken = any(part.get("state") == "down" for part in parts)
        broken = broken or gateway.store.trouble is not None
        faults = gateway.envelopes.faults_in(tenants)
        broken = broken or bool(faults)
        worst = "ok" if all(s == "ready" for s in states) and not broken else "degraded"
        if states and all(state == "down" for state in states):
            worst = "down"
        commands = gateway.commands
        return {
            "state": worst,
            "version": gateway_version(),
            "uptime": round(time.monotonic() - self.metrics.started, 3),
            "started": iso(self._started),
            "process": self._process_facts(),
            "host": {
                "name": platform.node(),
                "platform": platform.platform(),
                "python": platform.python_version(),
                "cpus": psutil.cpu_count() or 0,
            },
            "backends": [slot.plain() for slot in slots],
            "transports": self.transports,
            "adapters": self.adapters,
            "envelopes": faults,
            "sessions": len(gateway.sessions.known),
            "subscriptions": len(gateway.hub.subscriptions),
            "resources": len(gateway.registry.entries),
            "commands": {
                "running": len(commands.running) - commands.queued,
                "queued": commands.queued,
                "completed": commands.counts.get("completed", 0),
                "failed": commands.counts.get("failed", 0) + commands.counts.get("rejected", 0),
                "cancelled": commands.counts.get("cancelled", 0),
            },
            "queues": self._queues(tenants),
            "warnings": list(self._recent.records) if "*" in tenants else [],
        }

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
        gateway = self._gateway
        boxes = {
            session.id[:8]: session.connection.mailbox
            for session in gateway.sessions.known.values()
            if session.connection is not None and ("*" in tenants or session.tenant in tenants)
        }
        waiting = {id_: box.backlog for id_, box in boxes.items()}
        return {
            "depth": sum(waiting.values()),
            "high_water": max((box.high_water for box in boxes.values()), default=0),
            "dropped": sum(gateway.hub.dropped.values()) + _conflated(gateway),
            "by_session": {id_: depth for id_, depth in waiting.items() if depth},
        }

    # -- Prometheus ----------------------------------------------------------------------------

    def _families(self) -> Iterable[Metric]:
        gateway = self._gateway
        commands = gateway.commands
        facts = {"version": gateway_version(), "python": platform.python_version()}
        yield gauge("rcp_build_info", "What runs here.", tuple(facts), [(list(facts.values()), 1)])
        up = time.monotonic() - self.metrics.started
        yield gauge("rcp_uptime_seconds", "Since the start.", (), [([], up)])
        yield gauge(
            "rcp_backend_up",
            "Whether a backend is ready.",
            ("backend", "tenant"),
            [([s.name, s.tenant], float(s.backend is not None)) for s in self._slots],
        )
        yield counter(
            "rcp_requests",
            "Requests by their outcome.",
            ("transport", "type", "code"),
            [(list(key), count) for key, count in gateway.counts.items()],
        )
        yield histogram(
            "rcp_request_seconds", "From request to final reply.", (), [([], gateway.seconds)]
        )
        yield counter(
            "rcp_samples",
            "Samples that a backend published.",
            ("backend",),
            [([s.name], s.samples) for s in self._slots],
        )
        yield counter("rcp_updates", "Updates sent.", ("transport",), self._updates())
        dropped = {**gateway.hub.dropped}
        dropped["conflated"] += _conflated(gateway)
        yield counter(
            "rcp_dropped",
            "Samples not delivered.",
            ("reason",),
            [([reason], count) for reason, count in dropped.items()],
        )
        yield from self._gauges()
        yield counter(
            "rcp_commands",
            "Commands by final status.",
            ("status",),
            [([status], count) for status, count in commands.counts.items()],
        )
        yield histogram(
            "rcp_command_seconds", "Of finished commands.", (), [([], commands.seconds)]
        )
        yield gauge(
            "rcp_resource_age_seconds",
            "Age of the latest sample of paths with a deadline.",
            ("path",),
            [
                ([entry.path], entry.age)
                for entry in gateway.registry.entries.values()
                if entry.deadline is not None and entry.age is not None
            ],
        )

    def _gauges(self) -> Iterable[Metric]:
        gateway = self._gateway
        queues = self._queues(("*",))
        for name, text, value in (
            ("rcp_sessions", "Sessions held.", len(gateway.sessions.known)),
            ("rcp_subscriptions", "Subscriptions held.", len(gateway.hub.subscriptions)),
            ("rcp_queue_depth", "Messages waiting for clients.", queues["depth"]),
            ("rcp_event_loop_lag_seconds", "How late the event loop was.", self._lag_last),
        ):
            yield gauge(name, text, (), [([], float(value))])

    def _updates(self) -> list[tuple[list[str], float]]:
        sums = dict(self._gateway.sessions.updates)
        for session in self._gateway.sessions.known.values():
            if session.connection is not None:
                name = session.transport
                sums[name] = sums.get(name, 0) + session.connection.mailbox.updates
        return [([name], count) for name, count in sums.items()]


def _conflated(gateway: Gateway) -> int:
    return sum(feed.skipped for sub in gateway.hub.subscriptions for feed in sub.feeds.values())
