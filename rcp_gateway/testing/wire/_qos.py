"""Section 7 of the contract: quality of service, notices, and clients that do not keep up."""

from __future__ import annotations

import base64

from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World
from rcp_gateway.testing.wire._resources import Frame, Parcel
from rcp_gateway.testing.wire._streams import DEEP, LEVEL, bodies
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding

__all__ = ["Quality"]

_BIG = bytes(200_000)
_MANY = 80  # times the above: more than sockets hold


class Quality(Wire):
    """Tests of too much, too little and too late data."""

    @proves("stream.best-effort")
    async def test_best_effort_gives_the_newest_and_counts_what_it_skipped(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            id_ = await client.subscribe(LEVEL, initial=False)
            world.publish("sensor/level", 1.0, 2.0, 3.0)
            update = await client.update(id_)
            assert (update["body"], update["dropped"]) == (3.0, 2)
            world.publish("sensor/level", 4.0)
            assert "dropped" not in await client.update(id_)

    @proves("stream.reliable")
    async def test_reliable_skips_nothing(self, world: World) -> None:
        client = await world.client()
        qos = {"reliability": "reliable", "depth": 500}
        id_ = await client.subscribe(LEVEL, qos=qos, initial=False)
        for start in range(0, 1000, 250):
            world.publish("sensor/level", *map(float, range(start, start + 250)))
            found = [await client.update(id_) for _ in range(250)]
            assert [u["body"] for u in found] == [float(i) for i in range(start, start + 250)]
            assert [u["seq"] for u in found] == list(range(start + 1, start + 251))

    @proves("stream.overrun")
    async def test_reliable_ends_with_overrun_rather_than_skip(self, world: World) -> None:
        client = await world.client()
        qos = {"reliability": "reliable", "depth": 5}
        id_ = await client.subscribe(LEVEL, qos=qos, initial=False)
        world.publish("sensor/level", *map(float, range(20)))
        notice = await client.notice("overrun")
        assert (notice["id"], notice["error"]["code"]) == (id_, "overrun")
        assert world.server.gateway.hub.subscriptions == set()

    @proves("stream.deadline", "stream.stale")
    async def test_a_source_that_falls_silent_is_told(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        client = await world.client()
        id_ = await client.subscribe(LEVEL, qos={"deadline": 0.05})
        for code in ("deadline_missed", "stale"):
            notice = await client.notice(code)
            assert (notice["id"], notice["path"]) == (id_, LEVEL)

    @proves("stream.lifespan")
    async def test_a_sample_older_than_its_lifespan_is_not_delivered(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        client = await world.client()

        async def stale() -> None:
            reply = await client.request("read", LEVEL)
            while reply["state"] != "stale":
                reply = await client.request("read", LEVEL)

        await stale()
        id_ = await client.subscribe(LEVEL, qos={"lifespan": 0.1, **DEEP})
        world.publish("sensor/level", 2.0)
        assert await bodies(client, id_, 1) == [2.0]

    @proves("stream.priority")
    async def test_what_has_a_higher_priority_leaves_first(self, world: World) -> None:
        client = await world.client()
        low = await client.subscribe(LEVEL, qos={"priority": 0}, initial=False)
        high = await client.subscribe("/sensor/battery", qos={"priority": 7}, initial=False)
        world.publish("sensor/level", 1.0)
        world.publish("sensor/battery", {"voltage": 12.0})
        found = [await client.until(lambda m: m["type"] == "update") for _ in range(2)]
        assert [update["id"] for update in found] == [high, low]

    @proves("stream.native", "stream.native-decoded")
    async def test_the_robots_own_form_comes_as_it_is_or_decoded(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            native = await client.subscribe("/sensor/frame", encoding="native", initial=False)
            plain = await client.subscribe("/sensor/frame", initial=False)
            world.publish("sensor/frame", Frame(b"12345"))
            first = await client.update(native)
            body = first["body"]
            assert (base64.b64decode(body) if isinstance(body, str) else body) == b"12345"
            assert (first["encoding"], first["native_type"]) == ("native", "wire/Frame")
            assert await bodies(client, plain, 1) == [0.5]
            world.publish("sensor/frame", Frame(b"1"))
            assert "native_type" not in await client.update(native)

    @proves("stream.encoding")
    async def test_updates_may_come_in_another_encoding(self, world: World) -> None:
        client = await world.client(encoding=Encoding.CBOR)
        id_ = await client.subscribe(LEVEL, encoding="cbor", initial=False)
        world.publish("sensor/level", 2.0)
        assert await bodies(client, id_, 1) == [2.0]

    @proves("stream.denied")
    async def test_what_is_hidden_cannot_be_subscribed_to(self, world: World) -> None:
        client = await world.client(LOCAL)
        reply = await client.request("subscribe", "/sensor/secret")
        assert reply["error"]["code"] == "unknown_path"
        paths = ["/tenant/beta/**"]
        every = await client.subscribe("/sensor/**", paths=paths, initial=False, qos=DEEP)
        world.publish("sensor/secret", 1.0)
        world.robot("other").host.publish("sensor/level", 1.0)
        world.publish("sensor/level", 2.0)
        await client.until(lambda m: m.get("id") == every and m.get("path") == LEVEL)
        assert not [m for m in client.inbox if "secret" in str(m) or "beta" in str(m)]

    @proves("stream.appears")
    async def test_what_appears_joins_and_what_goes_is_told(self, world: World) -> None:
        client = await world.client()
        id_ = await client.subscribe("/sensor/*/thing")
        path = "/tenant/alpha/sensor/new/thing"
        for _ in range(2):
            world.robot().host.declare(
                Resource(
                    name="sensor/new/thing", description="New.", value=quantity("1"), live=True
                )
            )
            notice = await client.notice("resource_added")
            assert (notice["id"], notice["path"]) == (id_, path)
            world.publish("sensor/new/thing", 5.0)
            assert (await client.update(id_))["path"] == path
            world.robot().host.withdraw("sensor/new/thing")
            assert (await client.notice("resource_removed"))["path"] == path

    @proves("stream.bad-value")
    async def test_a_value_that_does_not_fit_is_never_seen(self, world: World) -> None:
        client = await world.client()
        id_ = await client.subscribe(LEVEL, qos=DEEP)
        world.publish("sensor/level", float("nan"), "high", 2.0)
        update = await client.update(id_)
        assert (update["body"], update["seq"]) == (2.0, 3)

    @proves("stream.limit")
    async def test_subscriptions_of_one_session_are_bounded(self, world: World) -> None:
        client = await world.client()
        for _ in range(40):
            await client.subscribe(LEVEL)
        reply = await client.request("subscribe", LEVEL)
        assert reply["error"]["code"] == "queue_full"

    @proves("stream.slow")
    async def test_a_client_that_does_not_read_delays_nobody(self, world: World) -> None:
        slow, quick = await world.client(), await world.client()
        path = "/sensor/parcel"
        held = await slow.subscribe(path, initial=False)
        id_ = await quick.subscribe(path, initial=False)
        slow.pause()
        for i in range(_MANY):
            world.publish("sensor/parcel", Parcel(i64=i, data=_BIG))
            assert (await quick.update(id_))["body"]["i64"] == i
        slow.resume()
        dropped, last = 0, -1
        while last < _MANY - 1:
            update = await slow.update(held)
            dropped, last = dropped + update.get("dropped", 0), update["body"]["i64"]
        assert dropped > 0

    @proves("stream.only-streams")
    async def test_without_a_stream_subscribe_is_refused(self, world: World) -> None:
        reply = await (await world.client()).request("subscribe", LEVEL)
        assert reply["error"]["code"] == "unsupported_operation"
        assert "/events" in reply["error"]["remedy"]
