"""Subscriptions: what comes, how often, and what happens to a client that does not keep up."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from kernel.world import Client, World
from rcp_gateway.testing import SteppedClock
from rcp_kernel.model import Resource
from rcp_kernel.spi import Publication
from rcp_kernel.types import Twist, quantity

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"


async def subscribed(client: Client, path: str = LEVEL, **options: Any) -> str:
    reply = await client.ask(type="subscribe", path=path, body=options)
    assert reply["status"] == "completed", reply
    return reply["body"]["subscription"]


def publish(world: World, *values: float) -> None:
    for value in values:
        world.robot.host.publish("sensor/level", value)


async def bodies(client: Client, id_: str, count: int) -> list[Any]:
    return [(await client.update(id_))["body"] for _ in range(count)]


async def test_the_present_value_comes_first_and_every_later_one_after_it(world: World) -> None:
    publish(world, 1.0)
    client = world.client()
    id_ = await subscribed(client, qos={"depth": 10})
    assert (await client.update(id_))["body"] == 1.0
    publish(world, 2.0, 3.0)
    first, second = await client.update(id_), await client.update(id_)
    assert [first["body"], second["body"]] == [2.0, 3.0]
    assert second["seq"] == first["seq"] + 1
    assert first["path"] == LEVEL


async def test_without_initial_only_what_is_new_comes(world: World) -> None:
    publish(world, 1.0)
    client = world.client()
    id_ = await subscribed(client, initial=False)
    publish(world, 2.0)
    assert (await client.update(id_))["body"] == 2.0


async def test_best_effort_gives_the_newest_and_counts_what_it_skipped(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client)
    publish(world, 1.0, 2.0, 3.0)
    update = await client.update(id_)
    assert (update["body"], update["dropped"]) == (3.0, 2)
    publish(world, 4.0)
    assert "dropped" not in await client.update(id_)


async def test_reliable_skips_nothing(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, qos={"reliability": "reliable", "depth": 100})
    publish(world, *map(float, range(100)))
    assert await bodies(client, id_, 100) == [float(i) for i in range(100)]


async def test_reliable_ends_with_overrun_rather_than_skip(world: World) -> None:
    client = world.client()
    await subscribed(client, qos={"reliability": "reliable", "depth": 5})
    publish(world, *map(float, range(6)))
    notice = await client.notice("overrun")
    assert notice["error"]["code"] == "overrun"
    reply = await client.ask(type="unsubscribe", body={"subscription": notice["id"]})
    assert reply["error"]["code"] == "unknown_path"


async def test_on_change_a_repeated_value_stays_away(world: World) -> None:
    publish(world, 1.0)
    client = world.client()
    id_ = await subscribed(client, on="change", qos={"depth": 10})
    publish(world, 1.0, 1.0, 2.0, 2.0, 1.0)
    assert await bodies(client, id_, 3) == [1.0, 2.0, 1.0]


@pytest.mark.parametrize(
    ("deadband", "expected"),
    [(0.5, [10.0, 10.6, 10.0]), ("10%", [10.0, 11.1]), ({"": 1.0}, [10.0, 11.1])],
)
async def test_a_deadband_holds_small_changes_back(
    world: World, deadband: Any, expected: list[float]
) -> None:
    client = world.client()
    id_ = await subscribed(client, deadband=deadband, qos={"depth": 10})
    publish(world, 10.0, 10.3, 10.6, 10.0, 10.1, 10.2 if deadband == 0.5 else 11.1)
    assert await bodies(client, id_, len(expected)) == expected


async def test_an_edge_fires_on_becoming_true_only(world: World) -> None:
    publish(world, 12.0)
    client = world.client()
    where = {"lt": 11.0, "edge": "rise"}
    id_ = await subscribed(client, where=where, qos={"depth": 10})
    publish(world, 10.0, 9.0, 12.0, 10.5)
    assert await bodies(client, id_, 2) == [10.0, 10.5]


class Gauge(msgspec.Struct, rename="camel"):
    fill_level: float
    tank_number: int = 7


async def test_fields_have_the_names_that_clients_read(world: World) -> None:
    world.robot.add(Resource(name="sensor/tank", description="A.", value=Gauge, live=True))
    client, fields = world.client(), ["fillLevel"]
    where, qos = {"field": "fillLevel", "gt": 1}, {"depth": 10}
    id_ = await subscribed(client, "/sensor/tank", where=where, fields=fields, qos=qos)
    for level in (0.5, 1.5, 0.7, 2.5):
        world.robot.host.publish("sensor/tank", Gauge(level))
    assert await bodies(client, id_, 2) == [{"fillLevel": 1.5}, {"fillLevel": 2.5}]
    read = await client.ask(type="read", path="/sensor/tank", body={"fields": fields})
    assert read["body"] == {"fillLevel": 2.5}


async def test_conditions_join_by_and_or_not(world: World) -> None:
    client = world.client()
    where = {"or": [{"and": [{"gt": 1}, {"lt": 3}]}, {"not": {"lt": 10}}]}
    id_ = await subscribed(client, where=where, qos={"depth": 10})
    publish(world, 1.0, 2.0, 3.0, 11.0)
    assert await bodies(client, id_, 2) == [2.0, 11.0]


async def test_fields_are_cut_out(world: World) -> None:
    client = world.client()
    path = "/tenant/alpha/actuator/drive"
    id_ = await subscribed(client, path, fields=["linear.x"])
    world.robot.host.publish("actuator/drive", Twist())
    assert (await client.update(id_))["body"] == {"linear": {"x": 0.0}}


async def test_history_comes_first_and_in_order(world: World) -> None:
    publish(world, 1.0, 2.0, 3.0)
    client = world.client()
    assert await bodies(client, await subscribed(client, history=2), 2) == [2.0, 3.0]
    assert await bodies(client, await subscribed(client, history="30s"), 3) == [1.0, 2.0, 3.0]


async def test_a_rate_lets_the_newest_through_at_its_time(world: World) -> None:
    publish(world, 1.0)
    client = world.client()
    id_ = await subscribed(client, rate=20)
    first = await client.update(id_)
    publish(world, 2.0, 3.0)
    second = await client.update(id_)
    assert (first["body"], second["body"]) == (1.0, 3.0)
    assert len([m for m in client.inbox if m["type"] == "update"]) == 0


async def test_the_first_period_of_a_rate_is_whole_on_a_machine_that_has_just_booted(
    world: World, stepped: SteppedClock, boot: Callable[[], None]
) -> None:
    boot()
    client = world.client()
    id_ = await subscribed(client, rate=0.01)
    stepped.advance(50)
    publish(world, 1.0)
    assert (await client.update(id_))["body"] == 1.0
    for value, seconds in ((2.0, 60), (3.0, 60)):
        stepped.advance(seconds)
        publish(world, value)
    assert (await client.update(id_))["body"] == 3.0


async def test_a_count_ends_the_subscription_by_itself(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, count=2, qos={"depth": 10})
    publish(world, 1.0, 2.0, 3.0)
    assert await bodies(client, id_, 2) == [1.0, 2.0]
    notice = await client.notice("subscription_ended")
    assert (notice["id"], notice["reason"]) == (id_, "count")


async def test_a_duration_ends_the_subscription_by_itself(world: World) -> None:
    client = world.client()
    await subscribed(client, duration=0.02)
    assert (await client.notice("subscription_ended"))["reason"] == "duration"


async def test_a_pattern_takes_in_what_appears_later_and_tells_of_both(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, "/sensor/**")
    world.robot.add(
        Resource(name="sensor/new/thing", description="New.", value=quantity("1"), live=True)
    )
    assert (await client.notice("resource_added"))["path"] == "/tenant/alpha/sensor/new/thing"
    world.robot.host.publish("sensor/new/thing", 5.0)
    update = await client.until(lambda m: m["type"] == "update" and m["path"].endswith("thing"))
    assert (update["id"], update["body"]) == (id_, 5.0)
    world.robot.remove("sensor/new/thing")
    assert (await client.notice("resource_removed"))["path"] == "/tenant/alpha/sensor/new/thing"


async def test_a_source_that_falls_silent_is_told_as_stale(
    world: World, stepped: SteppedClock
) -> None:
    publish(world, 1.0)
    client = world.client()
    await subscribed(client, qos={"deadline": 60.0})
    stepped.advance(100)
    assert (await client.notice("deadline_missed"))["path"] == LEVEL
    assert (await client.notice("stale"))["path"] == LEVEL
    assert (await client.ask(type="read", path=LEVEL))["state"] == "stale"


async def test_the_wanted_rate_reaches_the_source_and_goes_with_its_subscriber(
    world: World,
) -> None:
    client = world.client()
    lazy = "/tenant/alpha/sensor/lazy"
    slow = await subscribed(client, lazy, rate=2)
    assert (await client.update(slow))["body"] == 7.0
    fast = await subscribed(client, lazy, rate=20)
    await client.until(
        lambda m: ("sensor/lazy", 20.0) in world.robot.watched or m["type"] == "never"
    )
    await client.ask(type="unsubscribe", id=fast)
    await client.ask(type="unsubscribe", id=slow)
    rates = [rate for name, rate in world.robot.watched if name == "sensor/lazy"]
    assert rates[:2] == [2.0, 20.0]


async def test_a_read_of_what_is_only_published_while_watched_gets_it(world: World) -> None:
    reply = await world.client().ask(type="read", path="/sensor/lazy")
    assert reply["body"] == 7.0
    assert world.robot.left == [("sensor/lazy", None)]


async def test_a_value_that_is_read_has_the_time_of_its_measurement(world: World) -> None:
    world.robot.values["sensor/level"] = Publication("sensor/level", 3.0, 1_000_000_000)
    reply = await world.client().ask(type="read", path=LEVEL, body={"fresh": True})
    assert (reply["body"], reply["source_timestamp"]) == (3.0, "1970-01-01T00:00:01.000000000Z")


async def test_a_value_that_does_not_fit_is_never_delivered(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, qos={"depth": 10})
    publish(world, float("nan"), 2.0)
    assert (await client.update(id_))["body"] == 2.0
    status = (await client.ask(type="status"))["body"]
    assert status["backends"][0]["faults"] == 1


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"rate": -1}, "out_of_range"),
        ({"fields": ["nothing"]}, "filter_unsupported"),
        ({"where": {"field": "x", "like": 3}}, "filter_unsupported"),
        ({"deadband": "much"}, "filter_unsupported"),
        ({"history": "soon"}, "invalid_value"),
        ({"encoding": "native"}, "filter_unsupported"),
        ({"speed": 3}, "invalid_value"),
    ],
)
async def test_an_option_that_makes_no_sense_is_refused(
    world: World, options: dict[str, Any], code: str
) -> None:
    reply = await world.client().ask(type="subscribe", path=LEVEL, body=options)
    assert (reply["status"], reply["error"]["code"]) == ("rejected", code)


@pytest.mark.serial
async def test_updates_of_a_rate_never_come_in_pairs(world: World) -> None:
    client = world.client()
    id_ = await subscribed(client, rate=25)
    times: list[float] = []
    while len(times) < 12:
        publish(world, float(len(times)))
        await client.ask(type="ping")
        found = [m for m in client.inbox if m["type"] == "update" and m["id"] == id_]
        times += [time.monotonic() for _ in found]
        client.inbox.clear()
    # In pairs, every second one would follow by a ping: 5 of 11. The machine may look late at a few.
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert sum(gap < 0.04 * 0.4 for gap in gaps) < 5, gaps
