"""The metrics of the gateway in the format of Prometheus: the content of `/metrics`."""

from __future__ import annotations

import platform
from collections.abc import Callable, Generator, Iterable, Sequence
from operator import attrgetter

from prometheus_client.core import Metric

from rcp_gateway.status import StatusReport, count_skipped
from rcp_gateway.supervisor import BackendSupervisor
from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import parse_time
from rcp_kernel.contract.metrics import Metrics, RequestCounts, counter, gauge, histogram
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.spi import RobotLink
from rcp_kernel.tree.entry import RobotUnit
from rcp_kernel.tree.registry import Registry
from rcp_requests.journal import CommandJournal
from rcp_store.store import Store
from rcp_streams.hub import Hub

__all__ = ["Exposition"]

_PART = 50  # resources whose metrics are written per step
_LINK_COUNTS: tuple[tuple[str, str, Callable[[RobotLink], int]], ...] = (
    ("rcp_robot_link_sent_bytes", "Sent to the gateway of a robot.", attrgetter("sent")),
    ("rcp_robot_link_received_bytes", "Received from it.", attrgetter("received")),
    ("rcp_robot_links_lost", "Links with it that ended by a loss.", attrgetter("lost")),
)


class Exposition:
    """Collects the metrics that a principal may see."""

    def __init__(
        self,
        status: StatusReport,
        supervisors: Sequence[BackendSupervisor],
        *,
        registry: Registry,
        hub: Hub,
        sessions: Sessions,
        outbound: Outbound,
        journal: CommandJournal,
        counts: RequestCounts,
        store: Store,
        features: Callable[[], Iterable[Metric]],
    ) -> None:
        self._status = status
        self._supervisors = supervisors
        self._registry = registry
        self._hub = hub
        self._sessions = sessions
        self._outbound = outbound
        self._journal = journal
        self._counts = counts
        self._store = store
        self._feature_metrics = features
        self._metrics = Metrics()

    def write(self, rights: Rights) -> Generator[None, None, bytes]:
        """Write the exposition for a principal, in steps."""
        return self._metrics.exposition(self._families(rights))

    def _families(self, rights: Rights) -> Iterable[Metric]:
        yield from self._backend_families(rights)
        yield from self._traffic_families()
        yield from self._gauges()
        yield from self._command_families()
        yield from self._feature_metrics()
        yield from self._age_families(rights)

    def _backend_families(self, rights: Rights) -> Iterable[Metric]:
        facts = {"version": gateway_version(), "python": platform.python_version()}
        yield gauge("rcp_build_info", "What runs here.", tuple(facts), [(list(facts.values()), 1)])
        yield gauge("rcp_uptime_seconds", "Since the start.", (), [([], self._status.uptime)])
        yield gauge(
            "rcp_backend_up",
            "Whether a backend is ready.",
            ("backend", "tenant"),
            [([s.name, s.tenant], float(s.backend is not None)) for s in self._supervisors],
        )
        yield from self._robot_families(rights)
        yield gauge(
            "rcp_estop_latched",
            "Whether an e-stop holds a robot; `robot` is empty for all of a backend.",
            ("backend", "tenant", "robot"),
            [
                ([s.name, s.tenant, unit.robot or ""], float(unit.latch is not None))
                for s in self._supervisors
                for unit in s.units
                if unit.robot is None or self._status.sees(rights, unit)
            ],
        )
        yield gauge(
            "rcp_certificate_expiry_timestamp_seconds",
            "When the certificate of a listener expires.",
            ("transport",),
            [
                ([one["name"]], parse_time(one["certificate"]["expires"]) / 1e9)
                for one in self._status.transports
                if "certificate" in one
            ],
        )

    def _traffic_families(self) -> Iterable[Metric]:
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
        yield counter(
            "rcp_backend_refused",
            "Who or what was refused at the robots' side.",
            ("backend", "tenant", "code"),
            [
                ([s.name, s.tenant, code], count)
                for s in self._supervisors
                for code, count in s.refusals.items()
            ],
        )
        yield counter("rcp_updates", "Updates sent.", ("transport",), self._updates())
        dropped = {**self._hub.dropped}
        dropped["conflated"] += count_skipped(self._hub.subscriptions)
        yield counter(
            "rcp_dropped",
            "Samples not delivered.",
            ("reason",),
            [([reason], count) for reason, count in dropped.items()],
        )

    def _command_families(self) -> Iterable[Metric]:
        outbound, commands = self._outbound, self._journal
        yield counter(
            "rcp_queue_full",
            "What was done because too much waited for clients.",
            ("action",),
            [(["refused"], outbound.refused), (["closed"], outbound.closed_clients)],
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

    def _age_families(self, rights: Rights) -> Iterable[Metric]:
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
                if not self._status.sees(rights, unit):
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
        queues = self._status.queues(("*",))
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
            ("rcp_event_loop_lag_seconds", "How late the event loop was.", self._status.lag),
        ):
            yield gauge(name, text, (), [([], float(value))])

    def _updates(self) -> list[tuple[list[str], float]]:
        sums = dict(self._sessions.updates)
        for session in self._sessions.known.values():
            if session.connection is not None:
                name = session.transport
                sums[name] = sums.get(name, 0) + session.connection.outbox.updates
        return [([name], count) for name, count in sums.items()]


def _link_of(supervisor: BackendSupervisor, unit: RobotUnit) -> RobotLink | None:
    """Return the traffic of the link with a robot's own gateway, if its backend reports it."""
    backend = supervisor.backend
    if backend is None or unit.robot is None or not supervisor.has_gateways:
        return None
    try:
        return backend.robot_link(unit.robot)
    except Exception as error:  # one faulty backend must not hide the metrics of the others
        supervisor.fault(f"robot_link: {error!r}")
        return None


def _is_up(robot: RobotUnit) -> bool:
    return robot.availability in ("ready", "degraded")


def _by_status(counts: dict[tuple[str, str], int]) -> list[tuple[list[str], float]]:
    sums: dict[str, int] = {}
    for (_, status), count in counts.items():
        sums[status] = sums.get(status, 0) + count
    return [([status], count) for status, count in sums.items()]
