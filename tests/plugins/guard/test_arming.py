"""Which requests a gateway refuses after it stood still."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from rcp_guard_link.arming import GuardArming
from rcp_kernel.config.safety import Safety
from rcp_kernel.errors import StaleCommand

pytestmark = pytest.mark.anyio


class Bench:
    """A gateway's arming on a clock of its own, with one robot that the guard stops."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        clock = SimpleNamespace(monotonic=lambda: self.now)
        monkeypatch.setattr("rcp_guard_link.arming.time", clock)
        robot: Any = SimpleNamespace(name="rover", plans={"stop": {}})
        self.arming = GuardArming(asyncio.get_running_loop(), Safety(), [robot])
        self.arming.process.plans = {"rover/stop": {}}
        self.arming.armed = frozenset({"rover"})
        self._call: Any = SimpleNamespace(
            entry=SimpleNamespace(barred=True, path="/actuator/cmd_vel", owner=robot)
        )
        self.beat()

    def beat(self) -> None:
        """Send a heartbeat; the next one is due a period later."""
        self.arming.look_for_freeze()
        self.arming.expected = self.now + self.arming.period

    def beats(self, seconds: float, late: float = 0.0) -> None:
        """Let a time pass, with heartbeats."""
        end = self.now + seconds
        while self.now < end:
            self.now += self.arming.period + late
            self.beat()

    @property
    def refuses(self) -> bool:
        try:
            self.arming.admit(self._call)
        except StaleCommand:
            return True
        return False


async def test_requests_are_refused_for_half_a_second_after_a_freeze(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench(monkeypatch)
    assert not bench.refuses
    bench.now += 3.0
    assert bench.refuses  # before the heartbeat that is late
    bench.beats(0.4)
    assert bench.refuses
    bench.beats(0.3)
    assert not bench.refuses


async def test_a_gateway_that_cannot_catch_up_refuses_for_longer_but_not_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench(monkeypatch)
    bench.now += 3.0
    assert bench.refuses
    bench.beats(3.0, late=0.2)
    assert bench.refuses
    bench.beats(1.0)
    assert not bench.refuses
    bench.now += 3.0
    assert bench.refuses
    bench.beats(12.0, late=0.2)
    assert not bench.refuses


async def test_a_late_heartbeat_without_a_freeze_refuses_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench(monkeypatch)
    bench.beats(3.0, late=0.2)
    assert not bench.refuses
