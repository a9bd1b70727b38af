"""Section 7 of the protocol: filtering by subscriptions."""

from __future__ import annotations

import time
from typing import Any

from rcp_gateway.testing._client import Client, Message
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.wire._base import Wire, World
from rcp_kernel.clock import parse_time

__all__ = ["DEEP", "LEVEL", "Streams", "bodies"]

LEVEL = "/tenant/alpha/sensor/level"
DEEP = {"depth": 100}


async def bodies(client: Client, id_: str, count: int) -> list[Any]:
    """Return the values of the next updates of a subscription."""
    return [(await client.update(id_))["body"] for _ in range(count)]


def pack(voltage: float, charge: float = 1.0) -> dict[str, float]:
    """Return a value of the battery."""
    return {"voltage": voltage, "charge": charge}


class Streams(Wire):
    """The options, one by one."""

    @proves("stream.initial", "stream.update")
    async def test_the_present_value_comes_first_and_every_later_one_after_it(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            world.publish("sensor/level", 1.0)
            client = await world.client(encoding=encoding)
            id_ = await client.subscribe("/sensor/level", qos=DEEP)
            first = await client.update(id_)
            world.publish("sensor/level", 2.0, 3.0)
            second, third = await client.update(id_), await client.update(id_)
            assert [u["body"] for u in (first, second, third)] == [1.0, 2.0, 3.0]
            assert third["seq"] == second["seq"] + 1 == first["seq"] + 2
            assert {u["path"] for u in (first, second, third)} == {LEVEL}
            assert parse_time(third["timestamp"]) >= parse_time(first["timestamp"])
            assert "dropped" not in third

    @proves("stream.not-initial")
    async def test_without_initial_only_what_is_new_comes(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        client = await world.client()
        id_ = await client.subscribe(LEVEL, initial=False, qos=DEEP)
        world.publish("sensor/level", 2.0)
        assert await bodies(client, id_, 1) == [2.0]

    @proves("stream.paths")
    async def test_one_subscription_takes_several_paths(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        world.publish("sensor/battery", pack(12.0))
        client = await world.client()
        id_ = await client.subscribe(LEVEL, paths=["/sensor/battery", "/event/*"])
        world.publish("event/note", "boot")
        found = [await client.update(id_) for _ in range(3)]
        assert {u["path"].rpartition("/")[2] for u in found} == {"level", "battery", "note"}

    @proves("stream.pattern-long")
    async def test_a_long_value_comes_whole_only_to_who_named_its_path(self, world: World) -> None:
        world.limit(pattern_value=262_144)
        text = "x" * 300_000
        for encoding in self.encodings:
            world.publish("event/note", text)
            client = await world.client(encoding=encoding)
            by_pattern = await client.subscribe("/event/*", qos=DEEP)
            by_name = await client.subscribe("/event/note", paths=["/event/*"], qos=DEEP)
            world.publish("event/note", text, "short")
            found = [await client.update(by_pattern) for _ in range(3)]
            received = [(u.get("truncated"), u.get("body")) for u in found]
            assert received == [(True, None), (True, None), (None, "short")]
            assert "body" not in found[0]
            assert 300_000 <= found[0]["size"] <= 300_010
            assert [u["seq"] for u in found] == list(range(found[0]["seq"], found[2]["seq"] + 1))
            assert await bodies(client, by_name, 3) == [text, text, "short"]

    @proves("stream.rate")
    async def test_a_rate_lets_the_newest_through_at_its_time(self, world: World) -> None:
        client = await world.client()
        id_ = await client.subscribe(LEVEL, rate=2, initial=False)
        started = time.monotonic()
        world.publish("sensor/level", 1.0)
        assert await bodies(client, id_, 1) == [1.0]
        world.publish("sensor/level", 2.0, 3.0)
        assert await bodies(client, id_, 1) == [3.0]
        world.publish("sensor/level", 4.0, 5.0, 6.0)
        assert await bodies(client, id_, 1) == [6.0]
        assert time.monotonic() - started > 0.8

    @proves("stream.rate-source")
    async def test_the_wanted_rate_reaches_the_source_and_goes_with_its_subscriber(
        self, world: World
    ) -> None:
        robot = world.robot()
        client = await world.client()
        id_ = await client.subscribe("/sensor/lazy", rate=2)
        assert await bodies(client, id_, 1) == [7.0]
        assert robot.watched == [("sensor/lazy", 2.0)]
        assert robot.left == []
        await client.request("unsubscribe", body={"subscription": id_})

        async def left() -> bool:
            return robot.left == ["sensor/lazy"]

        await eventually(left, "the source is let go of")

    @proves("stream.change")
    async def test_on_change_a_repeated_value_stays_away(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        client = await world.client()
        id_ = await client.subscribe(LEVEL, on="change", qos=DEEP)
        world.publish("sensor/level", 1.0, 1.0, 2.0, 2.0, 1.0)
        assert await bodies(client, id_, 3) == [1.0, 2.0, 1.0]

    @proves("stream.deadband")
    async def test_a_deadband_holds_smaller_changes_back(self, world: World) -> None:
        client = await world.client()
        for deadband, values, expected in (
            (0.5, (10.0, 10.4, 10.5, 10.1, 10.0), [10.0, 10.5, 10.0]),
            ("10%", (20.0, 21.9, 22.0, 24.0, 24.3), [20.0, 22.0, 24.3]),
        ):
            id_ = await client.subscribe(LEVEL, deadband=deadband, initial=False, qos=DEEP)
            world.publish("sensor/level", *values)
            assert await bodies(client, id_, len(expected)) == expected
            await client.request("unsubscribe", body={"subscription": id_})
        band = {"voltage": 0.5, "charge": "50%"}
        id_ = await client.subscribe("/sensor/battery", deadband=band, qos=DEEP)
        packs = [pack(12.0), pack(12.4), pack(12.5), pack(12.6, 0.6), pack(12.6, 0.4)]
        world.publish("sensor/battery", *packs)
        assert await bodies(client, id_, 3) == [packs[0], packs[2], packs[4]]

    @proves("stream.where")
    async def test_a_condition_lets_through_what_it_holds_for(self, world: World) -> None:
        client = await world.client()
        where = {
            "or": [
                {"and": [{"field": "voltage", "lt": 11.1}, {"field": "charge", "ge": 0.5}]},
                {"not": {"field": "charge", "gt": 0.1}},
            ]
        }
        id_ = await client.subscribe("/sensor/battery", where=where, qos=DEEP)
        packs = [pack(12.0), pack(11.0), pack(11.0, 0.4), pack(12.0, 0.1), pack(10.0, 0.5)]
        world.publish("sensor/battery", *packs)
        assert await bodies(client, id_, 3) == [packs[1], packs[3], packs[4]]

    @proves("stream.edge")
    async def test_an_edge_fires_on_the_way_over_it(self, world: World) -> None:
        client = await world.client()
        for edge, expected in (
            ("rise", [10.0, 10.5]),
            ("fall", [12.0, 13.0]),
            ("both", [10.0, 12.0, 10.5, 13.0]),
        ):
            world.publish("sensor/level", 12.0)
            where = {"lt": 11.0, "edge": edge}
            id_ = await client.subscribe(LEVEL, where=where, qos=DEEP)
            world.publish("sensor/level", 10.0, 9.0, 12.0, 12.5, 10.5, 13.0)
            assert await bodies(client, id_, len(expected)) == expected
            await client.request("unsubscribe", body={"subscription": id_})

    @proves("stream.fields")
    async def test_a_projection_cuts_fields_out(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            id_ = await client.subscribe("/sensor/battery", fields=["voltage"], initial=False)
            world.publish("sensor/battery", pack(12.0))
            assert await bodies(client, id_, 1) == [{"voltage": 12.0}]

    @proves("stream.history")
    async def test_history_comes_first_and_in_order(self, world: World) -> None:
        world.publish("sensor/level", 1.0, 2.0, 3.0)
        client = await world.client()
        last = await client.subscribe(LEVEL, history=2)
        assert await bodies(client, last, 2) == [2.0, 3.0]
        world.publish("sensor/level", 4.0)
        assert await bodies(client, last, 1) == [4.0]
        lately = await client.subscribe(LEVEL, history="30s")
        assert await bodies(client, lately, 4) == [1.0, 2.0, 3.0, 4.0]

    @proves("stream.count")
    async def test_a_count_ends_the_subscription(self, world: World) -> None:
        client = await world.client()
        id_ = await client.subscribe(LEVEL, count=2, initial=False, qos=DEEP)
        world.publish("sensor/level", 1.0, 2.0, 3.0)
        assert await bodies(client, id_, 2) == [1.0, 2.0]
        notice = await client.notice("subscription_ended")
        assert (notice["id"], notice["reason"]) == (id_, "count")

    @proves("stream.duration")
    async def test_a_duration_ends_the_subscription(self, world: World) -> None:
        client = await world.client()
        id_ = await client.subscribe(LEVEL, duration=0.05)
        notice = await client.notice("subscription_ended")
        assert (notice["id"], notice["reason"]) == (id_, "duration")

    @proves("stream.refused")
    async def test_an_option_that_makes_no_sense_is_refused(self, world: World) -> None:
        client = await world.client()
        for options, code in (
            ({"rate": -1}, "out_of_range"),
            ({"on": "whim"}, "invalid_value"),
            ({"fields": ["nothing"]}, "filter_unsupported"),
            ({"where": {"field": "x", "like": 3}}, "filter_unsupported"),
            ({"where": {"lt": 3, "edge": "sideways"}}, "filter_unsupported"),
            ({"deadband": "much"}, "filter_unsupported"),
            ({"history": "soon"}, "invalid_value"),
            ({"encoding": "native"}, "filter_unsupported"),
            ({"qos": {"priority": 9}}, "out_of_range"),
            ({"count": 0}, "out_of_range"),
            ({"speed": 3}, "invalid_value"),
        ):
            reply = await client.request("subscribe", LEVEL, body=options)
            error_code = reply["error"]["code"]
            assert reply["status"] == "rejected"
            assert error_code in (code, "bad_request"), options  # a query may be wrong as such
        assert world.server.gateway.hub.subscriptions == set()

    @proves("stream.unsubscribe")
    async def test_after_unsubscribe_nothing_comes(self, world: World) -> None:
        client = await world.client()
        id_, other = [await client.subscribe(LEVEL, qos=DEEP) for _ in range(2)]
        done = await client.request("unsubscribe", body={"subscription": id_})
        assert done["status"] == "completed"
        world.publish("sensor/level", 5.0)
        assert await bodies(client, other, 1) == [5.0]
        assert not [m for m in client.inbox if m["type"] == "update"]

    @proves("stream.in-order")
    async def test_what_is_said_in_one_breath_of_a_subscription_happens_in_that_order(
        self, world: World
    ) -> None:
        client = await world.client()
        for _ in range(5):
            await client.send(type="subscribe", id="s", path="/**", body={"history": 100})
            await client.send(type="unsubscribe", id="s")
        await client.send(type="subscribe", id="s", path=LEVEL, body={"initial": False})
        replies = [await client.final("s") for _ in range(11)]
        received = [(reply["type"], reply["status"]) for reply in replies]
        pair = [("subscribe", "completed"), ("unsubscribe", "completed")]
        assert received == pair * 5 + pair[:1]
        client.inbox = [m for m in client.inbox if m["type"] != "update"]
        world.publish("sensor/level", 6.0)
        update = await client.update("s")
        assert (update["path"], update["body"]) == (LEVEL, 6.0)
        assert not [m for m in client.inbox if m["type"] == "update"]

    @proves("stream.which")
    async def test_a_subscription_is_ended_by_any_of_its_names(self, world: World) -> None:
        client = await world.client()
        endings: tuple[Message, ...] = (
            {"body": {"subscription": "s"}},
            {"id": "s"},
            {"path": "/sensor/level"},
        )
        for ending in endings:
            await client.request("subscribe", LEVEL, id="s")
            done = await client.final(await client.send(ending, type="unsubscribe"))
            assert done["body"] == {"subscriptions": ["s"]}, done
            gone = await client.final(await client.send(ending, type="unsubscribe"))
            assert gone["error"]["code"] == "unknown_path"
