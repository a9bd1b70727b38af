"""Prometheus: plain integers counted on the hot path, turned into families only at a scrape."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Generator, Iterable
from itertools import chain
from time import perf_counter

from prometheus_client import CollectorRegistry, GCCollector, PlatformCollector, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector

from rcp_kernel.wire import Reply

__all__ = [
    "BUCKETS",
    "SHORTEST",
    "Histogram",
    "Metrics",
    "RequestCounts",
    "counter",
    "gauge",
    "histogram",
]

BUCKETS = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0, 10.0)
"""Upper bounds in seconds."""
SHORTEST = BUCKETS[0]
"""Longest duration in the first bucket."""
_HEAD = 2  # lines of a family before its samples: HELP and TYPE


class Histogram:
    """Counts by bucket; most durations belong in the first one, the others take a `bisect`."""

    __slots__ = ("counts", "total")

    def __init__(self) -> None:
        self.counts = [0] * (len(BUCKETS) + 1)
        self.total = 0.0

    def observe(self, seconds: float) -> None:
        """Count one duration."""
        self.counts[0 if seconds <= SHORTEST else bisect_left(BUCKETS, seconds)] += 1
        self.total += seconds


class RequestCounts:
    """Counts final replies."""

    __slots__ = ("outcomes", "seconds")

    def __init__(self) -> None:
        self.outcomes: dict[tuple[str, str, str], int] = {}
        """Requests by transport, type and code."""
        self.seconds = Histogram()

    def conclude(self, transport: str, reply: Reply, started: float) -> None:
        """Count a final reply, and the time since `started`."""
        self.seconds.observe(perf_counter() - started)
        error = reply.error
        key = (transport, reply.type, "ok" if error is None else error["code"])
        try:
            self.outcomes[key] += 1
        except KeyError:
            self.outcomes[key] = 1

    def count(self, transport: str, type_: str, code: str) -> None:
        """Count one request by its outcome."""
        key = (transport, type_, code)
        self.outcomes[key] = self.outcomes.get(key, 0) + 1


def counter(
    name: str, text: str, labels: tuple[str, ...], rows: Iterable[tuple[list[str], float]]
) -> Metric:
    """Return a counter family, from rows of label values and count."""
    family = CounterMetricFamily(name, text, labels=labels)
    for values, count in rows:
        family.add_metric(values, count)
    return family


def gauge(
    name: str, text: str, labels: tuple[str, ...], rows: Iterable[tuple[list[str], float]]
) -> Metric:
    """Return a gauge family, from rows of label values and value."""
    family = GaugeMetricFamily(name, text, labels=labels)
    for values, value in rows:
        family.add_metric(values, value)
    return family


def histogram(
    name: str, text: str, labels: tuple[str, ...], rows: Iterable[tuple[list[str], Histogram]]
) -> Metric:
    """Return a histogram family, from rows of label values and histogram."""
    family = HistogramMetricFamily(name, text, labels=labels)
    for values, durations in rows:
        below = 0
        buckets: list[tuple[str, float]] = []
        for bound, count in zip((*map(str, BUCKETS), "+Inf"), durations.counts, strict=True):
            below += count
            buckets.append((bound, below))
        family.add_metric(values, buckets, durations.total)
    return family


class _Single(Collector):
    def __init__(self, metric: Metric) -> None:
        self._metric = metric

    def collect(self) -> Iterable[Metric]:
        return (self._metric,)


class Metrics:
    """The metrics of the process and of the gateway, for `/metrics`."""

    def __init__(self) -> None:
        registry = CollectorRegistry(auto_describe=False)
        ProcessCollector(registry=registry)
        PlatformCollector(registry=registry)
        GCCollector(registry=registry)
        self._registry = registry

    def exposition(self, families: Iterable[Metric]) -> Generator[None, None, bytes]:
        """Write the exposition, text format 0.0.4, in steps: one for each family.

        A long family is written in several parts.
        """
        written: list[bytes] = []
        last = ""
        for family in chain(self._registry.collect(), families):
            text = generate_latest(_Single(family))
            written.append(text.split(b"\n", _HEAD)[_HEAD] if family.name == last else text)
            last = family.name
            yield
        return b"".join(written)
