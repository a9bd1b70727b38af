"""Conditions: what they say of a robot, and that what is not known refuses."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from datetime import datetime
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kernel.world import BOUND, World
from rcp_conditions import Condition
from rcp_gateway.testing import SteppedClock
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.clock import Clock
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Resource
from rcp_kernel.tree.entry import Entry
from rcp_kernel.types import quantity

pytestmark = pytest.mark.anyio


class Gauge(msgspec.Struct, rename="camel"):
    fill_level: float = 0.0


class Battery(msgspec.Struct):
    percentage: Any = 80.0
    cells: list[float] = []


@pytest.fixture
def entry(world: World) -> Entry:
    """The drive of a robot with some state; what asks for something of it is at hand."""
    host = world.robot.host
    host.declare(
        Resource(name="sensor/battery", description="A.", value=Battery, live=True),
        Resource(name="sensor/battery-1", description="A.", value=Battery, live=True),
        Resource(name="sensor/arm/left", description="A.", value=quantity("rad"), live=True),
        Resource(name="sensor/mode", description="A.", value=str, live=True),
    )
    host.publish("sensor/battery", Battery(60.0, [3.5, 3.6]))
    host.publish("sensor/battery-1", Battery(10.0))
    host.publish("sensor/arm/left", 0.5)
    host.publish("sensor/mode", "auto")
    return world.server.gateway.registry.entries["/tenant/alpha/actuator/drive"]


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(BOUND):
        while not holds():  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.01)


def conditions(world: World) -> Conditions:
    return world.server.gateway.conditions


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sensor.battery.percentage > 20", True),
        ("sensor.battery.percentage > 70", False),
        ("sensor . battery . percentage > 20 // a remark on sensor", True),
        ('sensor["battery-1"].percentage > 20', False),
        ("sensor['battery'].percentage == 60.0", True),
        ("sensor.arm.left < 1.0", True),
        ("mode == 'auto'", True),
        ("mode.startsWith('au') && mode in ['auto', 'sensor.battery']", True),
        ("sensor.battery.cells.all(cell, cell > 3.0)", True),
        ("size(sensor.battery.cells) == 2 && sensor.battery.cells[1] == 3.6", True),
        ("sensor.none.at.all > 1", None),
        ("sensor.level > 1.0", None),
        ("sensor.battery.percent > 1", None),
        ("sensor.battery.percentage > 'high'", None),
        ("sensor.battery.percentage", None),
        ("!(sensor.none > 1)", None),
        ("sensor.none > 1 || mode == 'auto'", True),
        ("sensor.none > 1 && mode == 'manual'", False),
        ("1 / 0 == 1", None),
        ("sensor.battery.cells[7] > 1.0", None),
        ("9223372036854775807 + 1 > 0", None),
        ("int('x') == 1", None),
    ],
)
async def test_a_condition_holds_fails_or_cannot_be_known(
    world: World, entry: Entry, text: str, *, expected: bool | None
) -> None:
    assert conditions(world).holds(Condition(text), entry) is expected


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("sensor.battery >", "Syntax error"),
        ("battery > 1", "unknown name 'battery'"),
        ("size(sensor) == 0", "'sensor' alone is not a value"),
        ("'x' in param", "'param' alone is not a value"),
        ("time.second > 1", "time.hour, time.minute and time.weekday"),
        ("action.go == 1", "'action' has no value"),
        ("reboot(sensor.battery)", "there is no function 'reboot'"),
    ],
)
def test_what_is_wrong_with_a_condition_is_told_with_its_text(text: str, why: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Condition(text)
    assert why in str(caught.value)
    assert f"`{text}`" in str(caught.value)


async def test_a_field_has_the_name_that_clients_read(world: World, entry: Entry) -> None:
    host = world.robot.host
    host.declare(Resource(name="sensor/tank", description="A.", value=Gauge, live=True))
    host.publish("sensor/tank", Gauge(0.5))
    assert conditions(world).holds(Condition("sensor.tank.fillLevel > 0.4"), entry) is True
    assert conditions(world).holds(Condition("sensor.tank.fill_level > 0.4"), entry) is None


async def test_the_clock_is_the_gateways_own(world: World, entry: Entry) -> None:
    noon = datetime(2026, 5, 31, 12, 30).astimezone()  # a Sunday
    kernel = world.server.gateway
    told = Conditions(
        kernel.registry,
        Clock(now=lambda: int(noon.timestamp() * 1e9)),
        sustain=kernel.hub.sustain,
        is_published=kernel.hub.demand.holds,
    )
    text = "time.hour == 12 && time.minute == 30 && time.weekday == 6"
    assert told.holds(Condition(text), entry) is True
    system = world.server.gateway.registry.entries["/system/status"]
    assert told.holds(Condition(text), system) is True
    assert told.holds(Condition("mode == 'auto'"), system) is None


async def test_a_value_past_its_deadline_is_not_known(
    world: World, entry: Entry, stepped: SteppedClock
) -> None:
    fits = Condition("sensor.level > 0.0")
    world.robot.host.publish("sensor/level", 1.0)
    assert conditions(world).holds(fits, entry) is True
    stepped.advance(1.0)
    assert conditions(world).holds(fits, entry) is None


async def test_nothing_is_known_of_a_robot_that_is_gone(world: World, entry: Entry) -> None:
    fits = Condition("mode == 'auto'")
    assert conditions(world).holds(fits, entry) is True
    world.server.supervisors[0].report("unplugged", down=True)
    assert conditions(world).holds(fits, entry) is None


async def test_a_number_that_is_none_and_a_value_of_a_wrong_type_are_not_known(
    world: World, entry: Entry
) -> None:
    fits = Condition("sensor.battery.percentage != 5.0")
    for value in (Battery(float("nan")), Battery(float("inf")), "no battery"):
        world.robot.host.publish("sensor/battery", value)
        assert conditions(world).holds(fits, entry) is None


async def test_the_longest_name_that_is_a_resource_counts(world: World, entry: Entry) -> None:
    fits = Condition("sensor.battery.percentage > 20")
    host = world.robot.host
    host.declare(Resource(name="sensor/battery/percentage", description="A.", value=int, live=True))
    host.publish("sensor/battery/percentage", 5)
    assert conditions(world).holds(fits, entry) is False
    host.withdraw("sensor/battery/percentage")
    assert conditions(world).holds(fits, entry) is True


async def test_what_a_condition_names_is_watched_while_it_is_configured(
    world: World, entry: Entry
) -> None:
    fits = Condition("sensor.lazy > 5.0 && mode == 'auto'")
    assert conditions(world).holds(fits, entry) is None
    conditions(world).use("test", [fits])
    await until(lambda: world.robot.watched == [("sensor/lazy", 5.0)])
    assert conditions(world).holds(fits, entry) is True

    world.robot.remove("sensor/lazy")
    assert conditions(world).holds(fits, entry) is None
    world.robot.add(Resource(name="sensor/lazy", description="Again.", value=quantity("m")))
    await until(lambda: len(world.robot.watched) == 2)

    conditions(world).use("test", [])
    await until(lambda: len(world.robot.left) == 2)
    assert conditions(world).holds(fits, entry) is None


_words = st.sampled_from(
    re.findall(
        r"\S+",
        "sensor.battery.percentage mode time.hour 1 2.0 'a' true ( ) [ ] { } . , : ? && || ! - + / % "
        "== < in has size all exists map x null -9223372036854775808 1u",
    )
)


@given(st.lists(_words, max_size=12).map(" ".join) | st.text(max_size=20))
def test_no_text_does_more_than_be_wrong_or_unknown(text: str) -> None:
    try:
        condition = Condition(text)
    except ConfigError:
        return
    for values in ({}, dict.fromkeys((*condition.refs, *condition.times), 1)):
        assert condition.evaluate(values) in (True, False, None)
