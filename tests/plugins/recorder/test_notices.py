"""What is told of many robots is bounded, and written in steps between which a stop has its turn."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from rcp_kernel.contract.events import Event
from rcp_kernel.model import Operation
from rcp_recorder.channels import Message
from rcp_recorder.notices import Notices
from rcp_recorder.taps import SampleCounts, Taps
from rcp_scheduling.turns import at_once


class Robot:
    """A robot of one resource."""

    availability, detail, latch, tenant = "ready", None, None, "alpha"

    def __init__(self, name: str) -> None:
        self.name = self.robot = self.robot_segment = name
        self.owner = SimpleNamespace(name="fleet", robot=None)
        self.entry: Any = SimpleNamespace(
            unit=self, path=f"/tenant/alpha/sensor/{name}/speed", operations=Operation.EXECUTE
        )


class Recorded:
    """A recording of some robots."""

    def __init__(self, *robots: Robot) -> None:
        self.taken: list[Message] = []
        self.counts = SampleCounts()
        host: Any = SimpleNamespace(clock=SimpleNamespace(now=lambda: 1))
        self.taps = Taps(host, self.taken.append, self.counts, 1024)
        for robot in robots:
            self.taps.add(robot.entry)
        self.notices = Notices(host, self.counts)
        at_once(self.steps())  # what their states are
        self.taken.clear()

    def steps(self) -> Any:
        return self.notices.steps([("alpha", self.taps)])

    def lease(self, scope: str, did: str) -> None:
        event = Event(what="lease", principal=None, path=scope, facts={"did": did})
        self.notices.heard(event, 1)

    @property
    def told(self) -> list[dict[str, Any]]:
        return [msgspec.json.decode(message.data) for message in self.taken]


def robots(count: int) -> list[Robot]:
    return [Robot(f"rover{number}") for number in range(count)]


def test_of_each_lease_the_newest_are_kept_and_the_others_counted() -> None:
    found = Recorded(*robots(1))
    for number in range(100):
        found.lease("/tenant/alpha", f"number {number}")
    at_once(found.steps())
    assert [one["did"] for one in found.told] == [f"number {number}" for number in range(96, 100)]
    assert found.counts.notices == 96


def test_scopes_without_end_take_no_memory() -> None:
    found = Recorded(*robots(1))
    for number in range(5000):
        found.lease(f"/tenant/alpha/rover{number % 4990}", "acquire")
    found.lease("/tenant/alpha/rover0", "release")
    at_once(found.steps())
    assert [one["did"] for one in found.told] == ["acquire", "release"]
    assert found.counts.notices == 5001 - 1025  # of 1024 scopes, one has two


def test_many_leases_of_many_robots_are_written_in_small_steps() -> None:
    found = Recorded(*robots(200))
    for number in range(20):
        found.lease("/tenant/alpha", "acquire")
        found.lease(f"/tenant/alpha/rover{number}", "acquire")
        found.lease(f"/tenant/alpha/sensor/rover{number}/speed", "acquire")
    steps, most, before = found.steps(), 0, 0
    for _ in steps:
        most, before = max(most, len(found.taken) - before), len(found.taken)
    assert most <= 16
    assert len(found.taken) == 4 * 200 + 20 + 20


@pytest.mark.parametrize(
    ("scope", "names"),
    [
        ("/tenant/alpha", ["rover0", "rover1"]),
        ("/tenant/alpha/rover1", ["rover1"]),
        ("/tenant/alpha/sensor", ["rover0", "rover1"]),
        ("/tenant/alpha/sensor/rover0", ["rover0"]),
        ("/tenant/alpha/actuator", []),
        ("/tenant/beta", []),
    ],
)
def test_a_lease_is_told_of_the_robots_in_its_scope(scope: str, names: list[str]) -> None:
    found = Recorded(*robots(2))
    found.lease(scope, "acquire")
    at_once(found.steps())
    assert [one["robot"] for one in found.told] == [f"/tenant/alpha/{name}" for name in names]


def test_a_robot_that_is_gone_is_told_of_once_more_and_forgotten() -> None:
    here, gone = robots(2)
    found = Recorded(here, gone)
    found.taps.remove(gone.entry)
    gone.availability = "down"
    at_once(found.steps())
    assert [(one["robot"], one["state"]) for one in found.told] == [
        ("/tenant/alpha/rover1", "down")
    ]
    assert list(found.taps.units) == [here]
    found.taps.add(gone.entry)  # it comes back
    at_once(found.steps())
    assert [one["state"] for one in found.told] == ["down", "down"]
