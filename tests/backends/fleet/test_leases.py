"""Leases are the robot's: what one hub has been granted, no other hub is, nor anybody at the robot."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.cart import Cart
from backends.fleet.rig import appears, process_of, serving
from backends.fleet.test_two_hubs import Pair, opened
from configuration import key
from rcp_fleet.leases import hub_scope, robot_scope
from rcp_kernel.testing import ADMIN, OPERATOR, Client, Served, eventually, scripted

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_BOB = "b" * 40
_PEOPLE = key("bob", _BOB, role="operator")
_GO = "/tenant/alpha/action/r7/go"
_ROBOT, _TENANT = "/tenant/alpha/r7", "/tenant/alpha"


class _Site:
    """Two hubs and one robot, with ann, bob and an administrator at each."""

    def __init__(
        self, stack: AsyncExitStack, hubs: list[Served], robot: Served, cart: Cart
    ) -> None:
        self._stack, self._hubs, self.robot, self.cart = stack, hubs, robot, cart

    async def client(self, place: str, secret: str) -> Client:
        """Return a client at `h1`, `h2` or the robot."""
        served = {"h1": self._hubs[0], "h2": self._hubs[1], "robot": self.robot}[place]
        client = served.client(secret)
        self._stack.push_async_callback(client.close)
        if served is not self.robot:
            await appears(client, _GO)
        return client


@asynccontextmanager
async def _site(folder: Path, *, store: bool = False) -> AsyncGenerator[_Site]:
    pair = Pair(folder)
    async with AsyncExitStack() as stack:
        hubs = [
            await stack.enter_async_context(serving(pair.hub(hub, store=store) + _PEOPLE))
            for hub in pair.ports
        ]
        robot = await stack.enter_async_context(serving(pair.robot() + _PEOPLE, scripted(Cart)))
        cart: Any = robot.life.backend
        yield _Site(stack, hubs, robot, cart)


async def _lease(client: Client, do: str, scope: str = _ROBOT, **body: Any) -> dict[str, Any]:
    return await client.request(
        "execute", "/system/leases", body={"do": do, "scope": scope, **body}, within=_BOUND
    )


async def _leases(client: Client) -> list[tuple[str, str]]:
    found = (await client.request("read", "/system/leases"))["body"]
    return [(one["scope"], one["holder"]) for one in found]


async def _shows(client: Client, *leases: tuple[str, str]) -> None:
    async def shown() -> bool:
        return await _leases(client) == list(leases)

    await eventually(shown, f"the leases are {leases}", _BOUND)


async def test_a_lease_of_one_hub_locks_out_people_at_the_other_and_at_the_robot(
    tmp_path: Path,
) -> None:
    async with _site(tmp_path) as site:
        ann, bob = await site.client("h1", OPERATOR), await site.client("h2", _BOB)
        local = await site.client("robot", _BOB)
        held = await _lease(ann, "acquire", ttl=30, reason="by hand")
        assert held["status"] == "completed", held
        assert held["body"]["holder"] == "ann"
        for client, scope in ((bob, _ROBOT), (local, _TENANT)):
            refused = await _lease(client, "acquire", scope)
            assert refused["error"]["code"] == "lease_held", refused
            assert refused["error"]["details"]["holder"] == "ann"
            assert refused["error"]["details"]["scope"] == scope
            assert "ann holds the lease on " + scope in refused["error"]["message"]
        for client, path in ((bob, _GO), (local, "/tenant/alpha/action/go")):
            refused = await client.request("execute", path, body=1.0)
            assert refused["error"]["code"] == "lease_held", refused
            assert refused["error"]["details"]["holder"] == "ann"
        assert site.cart.ran == []
        await _shows(bob, (_ROBOT, "ann"))
        assert await _leases(ann) == [(_ROBOT, "ann")]
        site.cart.release.set()
        done = await ann.request("execute", _GO, body=1.0, within=_BOUND)
        assert done["status"] == "completed", done
        assert (await _lease(ann, "release"))["status"] == "completed"
        assert (await _lease(bob, "acquire"))["status"] == "completed"
        assert await _leases(local) == [(_TENANT, "bob")]
        refused = await ann.request("execute", _GO, body=1.0)
        assert refused["error"]["details"]["holder"] == "bob", refused


async def test_of_two_people_who_ask_at_once_one_gets_it(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        ann, bob = await site.client("h1", OPERATOR), await site.client("h2", _BOB)
        for _ in range(10):
            found = await asyncio.gather(_lease(ann, "acquire"), _lease(bob, "acquire"))
            assert sorted(one["status"] for one in found) == ["completed", "rejected"], found
            winner = ann if found[0]["status"] == "completed" else bob
            assert (await _lease(winner, "release"))["status"] == "completed"


async def test_a_lease_is_taken_over_across_hubs_and_what_ran_under_it_ends(
    tmp_path: Path,
) -> None:
    async with _site(tmp_path) as site:
        ann, root = await site.client("h1", OPERATOR), await site.client("h2", ADMIN)
        assert (await _lease(ann, "acquire", _TENANT, ttl=30))["status"] == "completed"
        running = await ann.send(type="execute", path=_GO, body=1.0)
        await asyncio.wait_for(site.cart.started.get(), _BOUND)
        refused = await _lease(root, "acquire")
        assert refused["error"]["code"] == "lease_held", refused
        taken = await _lease(root, "acquire", take=True, reason="fire")
        assert taken["status"] == "completed", taken
        assert (await ann.final(running, _BOUND))["status"] == "cancelled"
        lost = await ann.until(lambda m: m.get("code") == "lease_lost")
        assert (lost["scope"], lost["by"]) == (_TENANT, "root")
        refused = await ann.request("execute", _GO, body=1.0)
        assert refused["error"]["code"] == "lease_lost", refused
        await _shows(ann, (_ROBOT, "root"))


async def test_a_lease_is_renewed_and_expires_at_the_robot(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        ann, bob = await site.client("h1", OPERATOR), await site.client("h2", _BOB)
        local = await site.client("robot", _BOB)
        assert (await _lease(ann, "acquire", ttl=30))["status"] == "completed"
        (before,) = (await local.request("read", "/system/leases"))["body"]
        assert (await _lease(ann, "renew", ttl=50))["status"] == "completed"
        (after,) = (await local.request("read", "/system/leases"))["body"]
        assert (after["lease"], after["expires"] > before["expires"]) == (before["lease"], True)
        assert (await _lease(ann, "renew", ttl=0.2))["status"] == "completed"
        lost = await ann.until(lambda m: m.get("code") == "lease_lost")
        assert lost["scope"] == _ROBOT
        for client in (local, bob):
            await _shows(client)
        assert (await _lease(bob, "acquire"))["status"] == "completed"


async def test_a_lease_is_handed_over_at_the_robot(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        ann = await site.client("h1", OPERATOR)
        await site.client("h1", _BOB)
        assert (await _lease(ann, "acquire", ttl=30))["status"] == "completed"
        running = await ann.send(type="execute", path=_GO, body=1.0)
        await asyncio.wait_for(site.cart.started.get(), _BOUND)
        given = await _lease(ann, "hand_over", to="bob")
        assert given["status"] == "completed", given
        assert given["body"]["holder"] == "bob"
        local = await site.client("robot", ADMIN)
        assert await _leases(local) == [(_TENANT, "bob")]
        refused = await ann.request("execute", "/tenant/alpha/action/r7/tied", body=1.0)
        assert refused["error"]["code"] == "lease_held", refused
        site.cart.release.set()
        assert (await ann.final(running, _BOUND))["status"] == "completed"


async def test_a_person_keeps_the_lease_at_the_other_hub(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        first, second = await site.client("h1", OPERATOR), await site.client("h2", OPERATOR)
        assert (await _lease(first, "acquire", ttl=30))["status"] == "completed"
        running = await first.send(type="execute", path=_GO, body=1.0)
        await asyncio.wait_for(site.cart.started.get(), _BOUND)
        assert (await _lease(second, "acquire", ttl=30))["status"] == "completed"
        site.cart.release.set()
        assert (await first.final(running, _BOUND))["status"] == "completed"
        done = await second.request("execute", _GO, body=2.0, within=_BOUND)
        assert done["status"] == "completed", done


async def test_a_stop_by_one_hub_ends_the_leases_of_both(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        ann, root = await site.client("h1", OPERATOR), await site.client("h2", ADMIN)
        assert (await _lease(ann, "acquire", ttl=30))["status"] == "completed"
        stopped = await root.request("execute", "/system/estop", body={}, within=_BOUND)
        assert stopped["status"] == "completed"
        assert (await ann.until(lambda m: m.get("code") == "lease_lost"))["scope"] == _ROBOT
        local = await site.client("robot", ADMIN)
        for client in (ann, root, local):
            await _shows(client)


async def test_no_lease_is_granted_on_a_robot_that_cannot_be_asked(tmp_path: Path) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(pair.hub("h1")))
        ann = hub.client(OPERATOR)
        stack.push_async_callback(ann.close)
        await stack.enter_async_context(serving(pair.robot("r1", "h1"), scripted(Cart)))
        async with serving(pair.robot("r7", "h1"), scripted(Cart)):
            for robot in ("r1", "r7"):
                await appears(ann, f"/tenant/alpha/action/{robot}/go")
            assert (await _lease(ann, "acquire", ttl=30))["status"] == "completed"

        async def gone() -> bool:
            refused = await _lease(ann, "acquire", _TENANT)
            return refused["status"] == "rejected" and "'r7'" in refused["error"]["message"]

        await eventually(gone, "the robot is away", _BOUND)
        refused = await _lease(ann, "renew", ttl=30)
        assert refused["error"]["code"] == "adapter_unavailable", refused
        await _shows(ann, (_ROBOT, "ann"))  # none on r1: all or none
        assert (await _lease(ann, "acquire", "/tenant/alpha/r1"))["status"] == "completed"


async def test_a_cut_longer_than_a_lease_ends_it_at_both_ends(tmp_path: Path) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(pair.hub("h1")))
        ann = hub.client(OPERATOR)
        stack.push_async_callback(ann.close)
        async with serving(pair.robot("r7", "h1"), scripted(Cart)):
            await appears(ann, _GO)
            assert (await _lease(ann, "acquire", ttl=30))["status"] == "completed"
        # It returns without a store, and so without the lease.
        await stack.enter_async_context(serving(pair.robot("r7", "h1"), scripted(Cart)))
        lost = await ann.until(lambda m: m.get("code") == "lease_lost", _BOUND)
        assert (lost["scope"], lost["by"]) == (_ROBOT, "its own gateway")
        await _shows(ann)


async def test_a_hub_that_is_started_again_goes_on_with_a_lease_that_the_robot_still_holds(
    tmp_path: Path,
) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        robot = await stack.enter_async_context(serving(pair.robot("r7", "h1"), scripted(Cart)))
        robot.life.backend.release.set()
        ids: list[list[str]] = []
        for run in range(2):
            async with serving(pair.hub("h1", store=True)) as hub:
                ann = hub.client(OPERATOR)
                await appears(ann, _GO)
                if run == 0:
                    assert (await _lease(ann, "acquire", ttl=50))["status"] == "completed"
                local = robot.client(OPERATOR)
                both = [(await c.request("read", "/system/leases"))["body"] for c in (ann, local)]
                ids.append([one["lease"] for leases in both for one in leases])
                await local.close()
            await ann.close()
        assert len(ids[0]) == 2
        assert ids[0] == ids[1]


async def test_the_python_client_holds_a_lease_through_a_hub(tmp_path: Path) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        hub = process_of(tmp_path / "h1.toml", pair.hub("h1", listens=True))
        await stack.enter_async_context(hub)
        robot = await stack.enter_async_context(serving(pair.robot("r7", "h1"), scripted(Cart)))
        robot.life.backend.release.set()
        local = robot.client(ADMIN)
        stack.push_async_callback(local.close)
        person = await opened(stack, pair.urls.split(",")[0], 1)
        async with person.lease(_ROBOT, ttl=1.0):
            for number in range(30):  # longer than it lasts without being renewed
                assert await person.execute(_GO, float(number)) == number
                await asyncio.sleep(0.05)
            assert await _leases(local) == [(_TENANT, "ann")]
        await _shows(local)


@pytest.mark.parametrize(
    ("hub", "robot"),
    [
        ("/tenant/alpha/r7", "/tenant/alpha"),
        ("/tenant/alpha/actuator/r7", "/tenant/alpha/actuator"),
        ("/tenant/alpha/actuator/r7/arm/grip", "/tenant/alpha/actuator/arm/grip"),
    ],
)
def test_a_scope_is_the_same_in_the_paths_of_hub_and_robot(hub: str, robot: str) -> None:
    assert robot_scope(hub, "r7") == robot
    assert hub_scope(robot, "r7") == hub


def test_a_part_of_a_robot_that_the_hub_cannot_name_is_all_of_it() -> None:
    assert hub_scope("/tenant/alpha/left", "r7") == "/tenant/alpha/r7"
