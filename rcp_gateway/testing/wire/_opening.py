"""Backends that are not open yet: their possible paths are neither available nor unknown."""

from __future__ import annotations

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World

__all__ = ["Opening"]

_PATH = "/sensor/ghost/arrived"


def _waits(reply: Message) -> bool:
    """Return whether a refusal asks for a retry."""
    error = reply["error"]
    assert (reply["status"], error["code"]) == ("rejected", "adapter_unavailable"), reply
    assert error["path"] == "/tenant/alpha" + _PATH
    return error["retryable"] and error["retry_after"] > 0


class Opening(Wire):
    """A robot that is not available yet."""

    @proves("path.opening")
    async def test_what_a_backend_may_have_that_is_not_open_is_to_be_asked_for_again(
        self, world: World
    ) -> None:
        client = await world.client()
        for type_ in ("read", "write", "execute", "cancel"):
            assert _waits(await client.request(type_, _PATH)), type_
        await world.arrive()
        world.robot("ghost").host.publish("sensor/arrived", 2.0)
        assert (await client.request("read", _PATH))["body"] == 2.0
        gone = await client.request("read", "/sensor/ghost/never")
        assert (gone["error"]["code"], gone["error"]["retryable"]) == ("unknown_path", False)

    @proves("stream.opening")
    async def test_a_subscription_to_it_is_refused_until_it_is_there(self, world: World) -> None:
        client = await world.client()
        assert _waits(await client.request("subscribe", _PATH))
        await world.arrive()
        world.robot("ghost").host.publish("sensor/arrived", 2.0)
        id_ = await client.subscribe(_PATH)
        assert (await client.update(id_))["body"] == 2.0

    @proves("path.opening-hidden")
    async def test_a_hidden_path_is_unknown_whatever_opens(self, world: World) -> None:
        client = await world.client(LOCAL)
        for path in ("/sensor/ghost/secret", "/tenant/beta/sensor/none", "/tenant/no/sensor/none"):
            for type_ in ("read", "write", "execute", "cancel"):
                reply = await client.request(type_, path)
                assert reply["error"]["code"] == "unknown_path", (type_, path)

    @proves("discover.complete")
    async def test_discovery_says_that_more_may_come(self, world: World) -> None:
        client = await world.client()
        before = (await client.request("discover", "/**", body={"limit": 1}))["body"]
        assert before["complete"] is False
        other = (await client.request("discover", "/tenant/beta/**"))["body"]
        assert "complete" not in other
        await world.arrive()
        after = (await client.request("discover", "/**"))["body"]
        assert "complete" not in after
        assert after["generation"] > before["generation"]
        assert "/tenant/alpha" + _PATH in {found["path"] for found in after["resources"]}
