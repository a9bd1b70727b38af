"""Section 2 of the protocol: paths, patterns and hidden resources."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import Client, Message
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World

__all__ = ["Paths"]

NO_PATHS = (
    *("", "sensor/level", "/", "//level", "/sensor/le vel", "/sensor/ä", "/x/y"),
    *("/sensor/level/", "/sensor/../level?", "/sensor/" + "a" * 600),
)
NO_PATTERNS = ("/sensor/le*el", "/sensor/***", "/**/a/**/b/**/c/**", "sensor/*")


def _facts(reply: Message, path: str) -> Any:
    """Return what a client can learn from a refusal, independent of the path's name."""
    error = {key: item for key, item in reply["error"].items() if key != "trace_id"}
    kept = {k: item for k, item in reply.items() if k not in ("id", "timestamp", "error")}
    return str([kept, error]).replace(path, "<path>")


async def _paths(client: Client, pattern: str) -> list[str]:
    reply = await client.request("discover", pattern, body={"schemas": False})
    assert reply["status"] == "completed", reply
    return [found["path"] for found in reply["body"]["resources"]]


class Paths(Wire):
    """Tests of the resolution of paths."""

    @proves("path.relative", "path.full")
    async def test_a_relative_path_means_the_sessions_own_tenant(self, world: World) -> None:
        world.publish("sensor/level", 2.0)
        client = await world.client()
        for path in ("/sensor/level", "/tenant/alpha/sensor/level"):
            reply = await client.request("read", path)
            assert (reply["path"], reply["body"]) == ("/tenant/alpha/sensor/level", 2.0)

    @proves("path.robot")
    async def test_a_second_robot_of_a_tenant_stands_one_level_deeper(self, world: World) -> None:
        world.robot("drone").host.publish("sensor/level", 3.0)
        reply = await (await world.client()).request("read", "/sensor/drone1/level")
        assert (reply["path"], reply["body"]) == ("/tenant/alpha/sensor/drone1/level", 3.0)

    @proves("path.malformed")
    async def test_a_text_that_is_no_path_is_invalid_path(self, world: World) -> None:
        client = await world.client()
        for text in NO_PATHS:
            reply = await client.request("read", text)
            assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_path"), text

    @proves("path.unknown")
    async def test_a_path_that_leads_nowhere_is_unknown_path(self, world: World) -> None:
        client = await world.client()
        for type_ in ("read", "write", "execute", "cancel"):
            reply = await client.request(type_, "/sensor/nothing/here")
            assert reply["error"]["code"] == "unknown_path", type_
            assert reply["error"]["path"] == "/tenant/alpha/sensor/nothing/here"
            assert "discover" in reply["error"]["remedy"]

    @proves("path.hidden")
    async def test_a_hidden_resource_answers_as_one_that_is_not_there(self, world: World) -> None:
        world.publish("sensor/secret", 1.0)
        client = await world.client(LOCAL)
        for type_ in ("read", "write", "execute", "cancel"):
            hidden = await client.request(type_, "/sensor/secret", body=1)
            absent = await client.request(type_, "/sensor/absent", body=1)
            assert _facts(hidden, "secret") == _facts(absent, "absent")
        seen = await (await world.client()).request("read", "/sensor/secret")
        assert seen["body"] == 1.0

    @proves("path.tenant", "tenant.share-nothing")
    async def test_another_tenants_resource_answers_as_one_that_is_not_there(
        self, world: World
    ) -> None:
        world.robot("other").host.publish("sensor/level", 1.0)
        client = await world.client(LOCAL)
        hidden = await client.request("read", "/tenant/beta/sensor/level")
        absent = await client.request("read", "/tenant/gamma/sensor/level")
        assert _facts(hidden, "beta") == _facts(absent, "gamma")
        assert await _paths(client, "/tenant/beta/**") == []
        assert not [path for path in await _paths(client, "/**") if "beta" in path]
        report = (await client.request("status"))["body"]
        assert {backend["tenant"] for backend in report["backends"]} == {"alpha"}

    @proves("path.system")
    async def test_the_gateway_itself_stands_in_the_tree(self, world: World) -> None:
        client = await world.client()
        assert "/system/status" in await _paths(client, "/system/*")
        reply = await client.request("read", "/system/status")
        assert (reply["path"], reply["status"]) == ("/system/status", "completed")

    @proves("pattern.star")
    async def test_a_star_is_one_segment_and_two_are_any_number(self, world: World) -> None:
        client = await world.client()
        root = "/tenant/alpha/sensor/"
        one, every = await _paths(client, "/sensor/*"), await _paths(client, "/sensor/**")
        assert root + "level" in one
        assert root + "drone1/level" not in one
        assert {root + "level", root + "drone1/level"} <= set(every)
        assert await _paths(client, "/sensor/*/level") == [
            root + "drone1/level",
            root + "ghost/level",
        ]
        assert root + "level" in await _paths(client, "/sensor/**/level")
        assert "/tenant/beta/sensor/level" in await _paths(client, "/tenant/*/sensor/level")

    @proves("pattern.rights")
    async def test_a_pattern_never_reaches_what_is_hidden(self, world: World) -> None:
        world.publish("sensor/secret", 1.0)
        client = await world.client(LOCAL)
        for pattern in ("/**", "/sensor/*", "/sensor/secret", "/tenant/*/sensor/**"):
            assert not [p for p in await _paths(client, pattern) if "secret" in p or "beta" in p]
        read = await client.request("read", "/sensor/*", deadline=0.5)
        assert not [item for item in read["body"] if "secret" in item["path"]]

    @proves("pattern.malformed")
    async def test_a_text_that_is_no_pattern_is_invalid_path(self, world: World) -> None:
        client = await world.client()
        for text in NO_PATTERNS:
            for type_ in ("discover", "read"):
                reply = await client.request(type_, text)
                assert reply["error"]["code"] == "invalid_path", (type_, text)
