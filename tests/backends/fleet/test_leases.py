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
from plugins.client.heard import Heard
from rcp_fleet.leases import hub_scope, robot_scope
from rcp_gateway.testing import ADMIN, OPERATOR, Client, Served, eventually, scripted
from transports.cable import Cable

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_BOB = "b" * 40
_PEOPLE = key("bob", _BOB, role="operator")
_GO = "/tenant/alpha/action/r7/go"
_ROBOT, _TENANT = "/tenant/alpha/r7", "/tenant/alpha"


class _Site:
    """Two hubs and one robot, with ann, bob and an administrator at each."""

    def __init__(
        self, stack: AsyncExitStack, pair: Pair, hubs: list[Served], robot: Served, cart: Cart
    ) -> None:
        self._stack, self._pair, self._hubs = stack, pair, hubs
        self.robot, self.cart = robot, cart

    async def enter(self, robot: str) -> Served:
        """Run the gateway of another robot."""
        text = self._pair.robot(robot)
        return await self._stack.enter_async_context(serving(text, scripted(Cart)))

    async def client(self, place: str, secret: str) -> Client:
        """Return a client at `h1`, `h2` or the robot."""
        served = {"h1": self._hubs[0], "h2": self._hubs[1], "robot": self.robot}[place]
        client = served.client(secret)
        self._stack.push_async_callback(client.close)
        if served is not self.robot:
            await appears(client, _GO)
        return client


@asynccontextmanager
async def _site(folder: Path) -> AsyncGenerator[_Site]:
    pair = Pair(folder)
    async with AsyncExitStack() as stack:
        hubs = [
            await stack.enter_async_context(serving(pair.hub(hub) + _PEOPLE)) for hub in pair.ports
        ]
        robot = await stack.enter_async_context(serving(pair.robot() + _PEOPLE, scripted(Cart)))
        cart: Any = robot.life.backend
        yield _Site(stack, pair, hubs, robot, cart)


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


async def _moved(client: Client, former: str) -> None:
    """Let a client say where it was before, as one does that has lost its hub."""
    gone = await client.request("hello", body={"session": former})
    assert gone["error"]["code"] == "gap", gone
    assert (await client.request("hello"))["status"] == "completed"


async def test_a_program_keeps_its_lease_at_the_other_hub(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        first, second = await site.client("h1", OPERATOR), await site.client("h2", OPERATOR)
        former = (await first.request("hello"))["body"]["session"]
        assert (await _lease(first, "acquire", ttl=30))["status"] == "completed"
        running = await first.send(type="execute", path=_GO, body=1.0)
        await asyncio.wait_for(site.cart.started.get(), _BOUND)
        await _moved(second, former)
        assert (await _lease(second, "acquire", ttl=30))["status"] == "completed"
        lost = await first.until(lambda m: m.get("code") == "lease_lost", _BOUND)
        assert lost["by"] == "ann"
        assert (await _lease(first, "renew"))["error"]["code"] == "lease_lost"
        site.cart.release.set()
        assert (await first.final(running, _BOUND))["status"] == "completed"
        assert site.cart.stopped.empty()  # what ran goes on
        done = await second.request("execute", _GO, body=2.0, within=_BOUND)
        assert done["status"] == "completed", done
        refused = await first.request("execute", _GO, body=3.0, within=_BOUND)
        assert refused["error"]["code"] == "lease_lost", refused
        await _moved(first, (await second.request("hello"))["body"]["session"])
        assert (await _lease(first, "acquire"))["status"] == "completed"  # and back


async def test_two_programs_of_a_person_at_two_hubs_exclude_each_other(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        first, second = await site.client("h1", OPERATOR), await site.client("h2", OPERATOR)
        third = await site.client("h1", OPERATOR)
        assert (await _lease(first, "acquire", ttl=30))["status"] == "completed"
        site.cart.release.set()
        for other in (second, third):
            refused = await _lease(other, "acquire")
            assert refused["error"]["code"] == "lease_held", refused
            refused = await other.request("execute", _GO, body=1.0, within=_BOUND)
            assert refused["error"]["code"] == "lease_held", refused
            assert refused["error"]["details"]["holder"] == "ann"
        assert site.cart.ran == []
        assert (await first.request("execute", _GO, body=1.0, within=_BOUND))[
            "status"
        ] == "completed"
        await _moved(second, "s-of-nobody")
        assert (await _lease(second, "acquire"))["error"]["code"] == "lease_held"
        assert (await _lease(first, "renew", ttl=30))["status"] == "completed"
        assert (await _lease(first, "release"))["status"] == "completed"
        assert (await _lease(second, "acquire", ttl=30))["status"] == "completed"
        refused = await first.request("execute", _GO, body=2.0, within=_BOUND)
        assert refused["error"]["code"] == "lease_held", refused


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


async def test_of_two_robots_both_are_granted_or_none(tmp_path: Path) -> None:
    async with _site(tmp_path) as site:
        other = await site.enter("r1")
        ann, bob = await site.client("h1", OPERATOR), await site.client("h2", _BOB)
        for client in (ann, bob):
            await appears(client, _GO.replace("r7", "r1"))
        held = await _lease(bob, "acquire", ttl=50)
        assert held["status"] == "completed", held
        refused = await _lease(ann, "acquire", _TENANT, ttl=50)  # r1 is asked first, and grants it
        assert refused["error"]["code"] == "lease_held", refused
        assert refused["error"]["details"]["scope"] == _ROBOT
        local = other.client(OPERATOR)
        await _shows(local)  # it was given back
        await local.close()
        assert (await _lease(bob, "release"))["status"] == "completed"
        assert (await _lease(ann, "acquire", _TENANT, ttl=50))["status"] == "completed"
        for robot in ("r1", "r7"):
            refused = await bob.request("execute", f"/tenant/alpha/action/{robot}/go", body=1.0)
            assert refused["error"]["details"]["holder"] == "ann", refused


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


@pytest.mark.parametrize("when", ["before it arrives", "before it is answered"])
async def test_a_lease_that_is_cut_while_it_is_acquired_is_held_at_both_ends_or_at_none(
    tmp_path: Path, when: str
) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        hub = await enter(serving(pair.hub("h1") + _PEOPLE))
        cable = await enter(Cable(pair.ports["h1"]).laid())
        text = pair.robot("r7", "h1").replace(f":{pair.ports['h1']}", f":{cable.port}")
        robot = await enter(serving(text + _PEOPLE, scripted(Cart)))
        ann, local = hub.client(OPERATOR), robot.client(_BOB)
        stack.push_async_callback(ann.close)
        stack.push_async_callback(local.close)
        await appears(ann, _GO)
        assert (await _lease(ann, "acquire", ttl=30))["status"] == "completed"
        assert (await _lease(ann, "release"))["status"] == "completed"
        arrives = when == "before it is answered"
        if arrives:
            cable.slow(2_000)
        else:
            cable.freeze()
        asked = asyncio.create_task(_lease(ann, "acquire", ttl=30))

        async def held_up() -> bool:
            return cable.held > 0

        if arrives:
            await _shows(local, (_TENANT, "ann"))  # and the hub does not know it
        else:
            await eventually(held_up, "the request is held up", _BOUND)
            assert await _leases(local) == []
        cable.mend()
        cable.cut()
        reply = await asked
        if reply["status"] == "completed":
            await _shows(local, (_TENANT, "ann"))
            refused = await _lease(local, "acquire", _TENANT)
            assert refused["error"]["code"] == "lease_held", refused
            assert (await _lease(ann, "release"))["status"] == "completed"
        else:
            assert reply["error"]["retryable"], reply
        await _shows(local)
        assert (await _lease(local, "acquire", _TENANT))["status"] == "completed"


async def test_a_hub_that_is_started_again_goes_on_with_a_lease_that_the_robot_still_holds(
    tmp_path: Path,
) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        robot = await stack.enter_async_context(serving(pair.robot("r7", "h1"), scripted(Cart)))
        cart: Any = robot.life.backend
        cart.release.set()
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
        cart: Any = robot.life.backend
        cart.release.set()
        local = robot.client(ADMIN)
        stack.push_async_callback(local.close)
        person = await opened(stack, pair.urls.split(",")[0], 1)
        async with person.lease(_ROBOT, ttl=1.0):
            for number in range(30):  # longer than it lasts without being renewed
                assert await person.execute(_GO, float(number)) == number
                await asyncio.sleep(0.05)
            assert await _leases(local) == [(_TENANT, "ann")]
        await _shows(local)


async def test_the_python_client_keeps_its_lease_when_its_hub_is_killed(tmp_path: Path) -> None:
    pair, heard = Pair(tmp_path), Heard()
    async with AsyncExitStack() as stack:
        robot = await stack.enter_async_context(serving(pair.robot(), scripted(Cart)))
        cart: Any = robot.life.backend
        local = robot.client(ADMIN)
        stack.push_async_callback(local.close)
        first = process_of(tmp_path / "h1.toml", pair.hub("h1", listens=True))
        hub = await stack.enter_async_context(first)
        person = await opened(stack, pair.urls, 1, heard)
        second = process_of(tmp_path / "h2.toml", pair.hub("h2", listens=True))
        await stack.enter_async_context(second)
        await opened(stack, pair.urls.split(",")[1], 1)
        async with person.lease(_ROBOT, ttl=40.0) as lease:
            before = lease.facts["lease"]
            running = asyncio.create_task(person.execute(_GO, 1.0))
            await asyncio.wait_for(cart.started.get(), _BOUND)
            hub.kill()
            await heard.until("reconnected")

            async def kept() -> bool:
                return lease.facts["lease"] != before

            await eventually(kept, "the lease is the program's at the other hub", _BOUND)
            cart.release.set()
            assert await asyncio.wait_for(running, _BOUND) == 1.0
            assert await person.execute(_GO, 2.0) == 2.0
            assert cart.stopped.empty()
            lease.check()
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
