"""Answers that are longer than one page: they say so, and lead to the rest."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import BOUND, Client, Message
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import Wire, World
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding, dump

__all__ = ["Pages"]

MANY = 1348
"""Parameters of an ArduCopter."""
PATTERN = "/param/many/*"
LONG = 4096  # characters of a text


def _declare(world: World, count: int, type_: Any, value: Any) -> list[str]:
    """Give the main robot many parameters; return their paths in order.

    The deadline, at which a page ends too, is far: on a busy machine 1000 values take seconds.
    """
    world.limit(deadline=BOUND)
    robot = world.robot()
    names = [f"param/many/p{number:04}" for number in range(count)]
    robot.host.declare(
        *(Resource(name=name, description="One of many.", value=type_) for name in names)
    )
    robot.values.update(dict.fromkeys(names, value))
    return [f"/tenant/alpha/{name}" for name in names]


async def _pages(
    client: Client, type_: str, pattern: str, body: Message | None = None
) -> list[Message]:
    """Follow the cursors of a request to its end; every page but the last says that it is cut."""
    found: list[Message] = []
    cursor: Message = {}
    while True:
        options = {**(body or {}), **cursor}
        reply = await client.request(type_, pattern, body=options, deadline=BOUND)
        assert reply["status"] == "completed", reply.get("error")
        found.append(reply)
        assert reply.get("truncated", False) is ("cursor" in reply)
        if "cursor" not in reply:
            return found
        cursor = {"cursor": reply["cursor"]}
        assert len(found) < MANY, "the pages have no end"


def _paths(pages: list[Message]) -> list[str]:
    return [item["path"] for page in pages for item in page["body"]]


class Pages(Wire):
    """Nothing is left out without a word."""

    @proves("read.pages")
    async def test_a_pattern_that_reads_more_than_a_page_says_so_and_gives_the_rest(
        self, world: World
    ) -> None:
        names = _declare(world, MANY, quantity("1"), 0.5)
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            pages = await _pages(client, "read", PATTERN)
            assert [len(page["body"]) for page in pages] == [1000, MANY - 1000]
            assert _paths(pages) == names
            assert {item["body"] for page in pages for item in page["body"]} == {0.5}
        client = await world.client()
        small = await _pages(client, "read", "/tenant/*/param/many/**", {"limit": 300})
        assert [len(page["body"]) for page in small] == [300] * 4 + [MANY - 1200]
        assert _paths(small) == names

    @proves("read.page-bytes")
    async def test_a_page_has_no_more_bytes_than_a_message_may_have(self, world: World) -> None:
        names = _declare(world, 200, str, "x" * LONG)
        client = await world.client()
        longest = world.server.client_api.limits.message
        pages = await _pages(client, "read", PATTERN)
        assert len(pages) > 2
        assert all(len(dump(page["body"], Encoding.JSON)) <= longest for page in pages)
        assert _paths(pages) == names
        world.robot().values["param/many/p0000"] = "x" * longest  # longer than any page
        first, *rest = await _pages(client, "read", PATTERN)
        assert [len(item["body"]) for item in first["body"]] == [longest]
        assert _paths([first, *rest]) == names

    @proves("read.page-order")
    async def test_what_comes_and_goes_between_pages_neither_hides_nor_repeats_the_rest(
        self, world: World
    ) -> None:
        names = _declare(world, 30, quantity("1"), 0.5)
        client = await world.client()
        first = await client.request("read", PATTERN, body={"limit": 10})
        host = world.robot().host
        host.withdraw("param/many/p0009")  # the one that the cursor is about
        host.declare(Resource(name="param/many/a", description="New.", value=quantity("1")))
        body = {"limit": 1000, "cursor": first["cursor"]}
        rest = await client.request("read", PATTERN, body=body)
        assert _paths([first, rest]) == names

    @proves("read.cursor-refused")
    async def test_a_cursor_that_is_none_is_refused(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        client = await world.client()
        for path, body, code in (
            (PATTERN, {"cursor": "not one of ours"}, "bad_request"),
            (PATTERN, {"cursor": 3}, "invalid_value"),
            (PATTERN, {"limit": 0}, "out_of_range"),
            (PATTERN, {"limit": 1001}, "out_of_range"),
            ("/sensor/level", {"cursor": "L3RlbmFudA=="}, "filter_unsupported"),
        ):
            reply = await client.request("read", path, body=body)
            assert (reply["status"], reply["error"]["code"]) == ("rejected", code), body

    @proves("discover.truncated")
    async def test_a_page_of_discovery_says_that_it_is_one(self, world: World) -> None:
        names = _declare(world, MANY, quantity("1"), 0.5)
        client = await world.client()
        pages = await _pages(client, "discover", PATTERN, {"limit": 1000, "schemas": False})
        assert [page["body"].get("cursor") for page in pages] == [p.get("cursor") for p in pages]
        found = [one["path"] for page in pages for one in page["body"]["resources"]]
        assert found == names

    @proves("envelope.batch-pages")
    async def test_a_batch_of_patterns_stays_bounded_and_says_what_it_left_out(
        self, world: World
    ) -> None:
        names = _declare(world, 200, str, "x" * LONG)
        client = await world.client()
        read: Message = {"type": "read", "path": PATTERN}
        reply = await client.request(
            "batch", body=[{**read, "deadline": BOUND}] * 8, deadline=BOUND
        )
        assert reply["status"] == "completed", reply.get("error")
        assert len(dump(reply["body"], Encoding.JSON)) <= world.server.client_api.limits.message
        for part in reply["body"]:
            assert (part["status"], part["truncated"]) == ("completed", True)
            rest = await _pages(client, "read", PATTERN, {"cursor": part["cursor"]})
            assert _paths([part, *rest]) == names

    @proves("envelope.batch-bytes")
    async def test_a_batch_refers_what_it_has_no_room_for_to_requests_of_their_own(
        self, world: World
    ) -> None:
        longest = world.server.client_api.limits.message
        (name,) = _declare(world, 1, str, "x" * (longest // 4))
        client = await world.client()
        read: Message = {"type": "read", "path": name}
        reply = await client.request("batch", body=[read] * 8)
        assert len(dump(reply["body"], Encoding.JSON)) <= 2 * longest
        statuses = [part["status"] for part in reply["body"]]
        assert statuses == ["completed"] * 3 + ["rejected"] * 5
        assert {part["error"]["code"] for part in reply["body"][3:]} == {"payload_too_large"}
        assert len((await client.request("read", name))["body"]) == longest // 4

    @proves("discover.page-bytes")
    async def test_a_page_of_discovery_has_no_more_bytes_than_a_message_may_have(
        self, world: World
    ) -> None:
        names = _declare(world, MANY, quantity("1"), 0.5)
        client = await world.client()
        longest = world.server.client_api.limits.message
        pages = await _pages(client, "discover", PATTERN, {"limit": 1000})
        for page in pages:
            assert len(dump(page["body"]["resources"], Encoding.JSON)) <= longest
        found = [one["path"] for page in pages for one in page["body"]["resources"]]
        assert found == names

    @proves("stream.subscribe-pages")
    async def test_a_subscription_lists_its_paths_in_pages(self, world: World) -> None:
        names = _declare(world, MANY, quantity("1"), 0.5)
        client = await world.client()
        reply = await client.request("subscribe", body={"paths": [PATTERN, "/sensor/level"]})
        assert reply["truncated"] is True
        assert reply["body"]["count"] == MANY + 1
        assert reply["body"]["paths"] == names[:1000]
        query = {"op": "subscribe", "cursor": reply["cursor"], "limit": 1000}
        rest = await client.request("discover", PATTERN, body=query)
        assert [one["path"] for one in rest["body"]["resources"]] == names[1000:]
        whole = await client.request("subscribe", "/sensor/level", id="one")
        assert (whole["body"]["paths"], "truncated" in whole) == ([whole["path"]], False)

    @proves("stream.initial-whole")
    async def test_a_subscription_begins_with_every_value_that_its_pattern_reaches(
        self, world: World
    ) -> None:
        names = _declare(world, MANY, quantity("1"), 0.5)
        for name in names:
            world.publish(name.removeprefix("/tenant/alpha/"), 0.25)
        client = await world.client()
        id_ = await client.subscribe(PATTERN)
        updates = [await client.update(id_) for _ in names]
        assert sorted(update["path"] for update in updates) == names
