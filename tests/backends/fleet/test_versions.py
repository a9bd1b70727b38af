"""A hub and a robot's gateway of different versions: each does without what the other lacks."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Any

import msgspec
import pytest

pytest.importorskip("zenoh")

from backends.fleet.recording import FOLDER, RecordedGateway, exchanges
from backends.fleet.rig import SIM, appears, hub_at, robot_at, serving
from configuration import configuration, key, role, rule, table
from ports import free_port
from rcp_gateway.testing import ADMIN, OPERATOR, Client, eventually
from rcp_kernel.values import value_type

pytestmark = pytest.mark.anyio
_POSE, _LINK = "/tenant/alpha/sensor/r7/pose", "/tenant/alpha/sensor/r7/link"
_MOVE = "/tenant/alpha/action/r7/move_to"
_BOUND = 60.0  # s, on any machine
_VERSIONS = sorted(file.stem for file in FOLDER.glob("*.json"))
_SPEED = "/tenant/alpha/param/r7/speed_limit"


def _early(port: int) -> str:
    """Return the configuration of a gateway that has, for its hub, only what the first ones had."""
    zenoh = table(
        "transports.zenoh", gateway="r7", tenant="alpha", connect=[f"tcp/127.0.0.1:{port}"]
    )
    own = rule("execute read subscribe", "/system/estop")
    early = role("early", rule("read write execute subscribe", "/tenant/**"), own, reset=True)
    return configuration(zenoh, SIM, early, key("hub", OPERATOR, role="early"))


async def _lacks(client: Client, *paths: str) -> None:
    found: list[Any] = []

    async def told() -> bool:
        link = (await client.request("read", _LINK))["body"]
        found[:] = [link["state"], link.get("lacks", [])]
        return found == ["ready", list(paths)]

    await eventually(told, f"the link lacks {paths}", _BOUND)


async def test_a_gateway_without_what_later_ones_offer_is_used_and_what_it_lacks_is_named() -> None:
    port = free_port()
    async with serving(hub_at(port) + key("root", ADMIN, role="admin")) as hub:
        client = hub.client(ADMIN)
        async with serving(_early(port)):
            await appears(client, _POSE)
            await _lacks(
                client, "/system/leases", "/system/robots", "/system/status", "/system/tree"
            )
            assert (await client.request("read", _POSE, body={"fresh": True}))["body"]
            goal = {"position": {"x": 0.1, "y": 0.0}}
            assert (await client.request("execute", _MOVE, body=goal))["status"] == "completed"
            id_ = await client.subscribe(_POSE)
            assert (await client.update(id_))["path"] == _POSE
            stopped = await client.request("execute", "/system/estop", body={}, within=_BOUND)
            assert stopped["status"] == "completed"
            freed = await client.request("execute", "/system/estop", body={"reset": True})
            assert freed["status"] == "completed"
        async with serving(robot_at(port)):  # it is replaced by one that has them
            await _lacks(client)
            shown = (await client.request("read", "/system/robots"))["body"]
            assert [one["path"] for one in shown] == ["/tenant/alpha/r7"]
        await client.close()


class _FirstRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A request for a lease as the first gateways knew it."""

    do: str
    scope: str | None = None
    lease: str | None = None
    ttl: float | None = None
    take: bool = False
    to: str | None = None
    reason: str | None = None


async def test_a_gateway_that_does_not_know_programs_grants_leases(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port)) as robot:
        entry = robot.server.gateway.registry.entries["/system/leases"]
        monkeypatch.setattr(entry, "input_type", value_type(_FirstRequest))
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        for do in ("acquire", "renew", "release"):
            asked = {"do": do, "scope": "/tenant/alpha/r7"}
            reply = await client.request("execute", "/system/leases", body=asked, within=_BOUND)
            assert reply["status"] == "completed", reply
        await client.close()


@pytest.mark.parametrize("version", _VERSIONS)
async def test_this_hub_uses_a_robot_whose_gateway_is_of(version: str) -> None:
    port, recorded = free_port(), exchanges(version)
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(hub_at(port)))
        robot = await RecordedGateway.joined(stack, port, recorded)
        client = hub.client(OPERATOR)
        stack.push_async_callback(client.close)
        await appears(client, _POSE)
        await _lacks(client)
        assert (await client.request("read", _LINK))["body"]["version"] == version
        pose = (await client.request("read", _POSE, body={"fresh": True}))["body"]
        assert pose in [one["answers"][0].get("body") for one in recorded]
        assert (await client.request("write", _SPEED, body=0.5))["status"] == "completed"
        goal = {"position": {"x": 0.1, "y": 0.0}}
        replies = await client.replies(
            await client.send({"type": "execute", "path": _MOVE, "body": goal}), _BOUND
        )
        assert [replies[at]["status"] for at in (0, -1)] == ["accepted", "completed"]
        id_ = await client.subscribe(_POSE)
        assert (await client.update(id_))["path"] == _POSE
        stopped = await client.request("execute", "/system/estop", body={}, within=_BOUND)
        assert stopped["body"]["robots"]["fleet/r7"]["state"] == "confirmed"
        unknown = set(robot.asked) - {_asked(one["request"]) for one in recorded}
        assert unknown <= {("unsubscribe", None)}, "the recording does not tell what it answers"


@pytest.mark.parametrize("version", _VERSIONS)
async def test_this_gateway_answers_a_hub_of(version: str) -> None:
    async with serving(configuration(SIM, key("hub", ADMIN, role="admin"))) as robot:
        client = robot.client(ADMIN)
        for one in exchanges(version)[1:]:
            request, recorded = one["request"], _final(one["answers"])
            reply = _final(await client.replies(await client.send(request), _BOUND))
            assert reply["status"] == recorded["status"], (request, reply)
            lost = _lost(recorded.get("body"), reply.get("body"))
            assert not lost, (request, lost)
        await client.close()


def _asked(request: dict[str, Any]) -> tuple[str, str | None]:
    return request["type"], request.get("path")


def _final(answers: list[dict[str, Any]]) -> dict[str, Any]:
    return [answer for answer in answers if answer["type"] != "update"][-1]


def _lost(before: Any, after: Any, where: str = "body") -> list[str]:
    """Return what was there and is not, or is of another type."""
    if isinstance(before, dict) and isinstance(after, dict):
        gone = [f"{where}.{name}" for name in before if name not in after]
        both = [name for name in before if name in after]
        return gone + [
            x for name in both for x in _lost(before[name], after[name], f"{where}.{name}")
        ]
    if isinstance(before, list) and isinstance(after, list):
        pairs = enumerate(zip(before, after, strict=False))
        return [x for at, (old, new) in pairs for x in _lost(old, new, f"{where}[{at}]")]
    numbers = (int, float)
    same = type(before) is type(after) or (
        isinstance(before, numbers) and isinstance(after, numbers)
    )
    return [] if same else [where]
