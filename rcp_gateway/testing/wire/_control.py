"""Section 10 of the contract: who commands a robot, how old a command may be, and the e-stop."""

from __future__ import annotations

import time
from typing import Any

from rcp_gateway.testing._client import BOUND, Client, Message
from rcp_gateway.testing._serve import ADMIN, OPERATOR, VIEWER
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World
from rcp_kernel.types import LinearVelocity, Twist

__all__ = ["Control"]

DRIVE = "/tenant/alpha/actuator/drive"
LINE = "/tenant/alpha/action/line"
FORWARD: Message = {"linear": {"x": 0.5}}
MAX_AGE = 10.0  # s, of the line
_STOP = 0.5  # s that a stop is waited for


def code(reply: Message) -> str:
    """Return the error of a reply, or its status."""
    return reply.get("error", {}).get("code", reply["status"])


async def lease(client: Client, **fields: object) -> Message:
    """Ask for the actuators."""
    body = {"do": "acquire", "scope": "/tenant/alpha/actuator", **fields}
    return await client.request("execute", "/system/leases", body=body)


async def estop(client: Client, **fields: object) -> Message:
    """Stop or reset, without waiting for a stop: a missing backend never confirms it."""
    deadline = BOUND if "reset" in fields else _STOP
    return await client.request("execute", "/system/estop", body=fields, deadline=deadline)


async def drive(client: Client, **fields: Any) -> str:
    """Move."""
    return code(await client.request("write", DRIVE, body=FORWARD, **fields))


async def passed(moment: float) -> None:
    """Wait until a moment has passed."""

    async def over() -> bool:
        return time.time() > moment

    await eventually(over, "time goes on")


class Control(Wire):
    """Leases, the age of commands, the e-stop."""

    @proves("control.lease")
    async def test_a_lease_on_a_sub_tree_is_held_against_others(self, world: World) -> None:
        holder, other = await world.client(OPERATOR), await world.client(LOCAL)
        held = (await lease(holder, ttl=30))["body"]
        assert held["holder"] == "operator"
        reply = await other.request("write", DRIVE, body=FORWARD)
        assert code(reply) == "lease_held"
        details = reply["error"]["details"]
        assert (details["holder"], details["expires"]) == ("operator", held["expires"])
        assert code(await other.request("write", "/param/limit", body=1.0)) == "completed"
        assert await drive(holder) == "completed"
        by_id = {"do": "release", "lease": held["lease"]}
        assert code(await holder.request("execute", "/system/leases", body=by_id)) == "completed"
        assert await drive(other) == "completed"

    @proves("control.take-over")
    async def test_a_higher_priority_takes_over_with_a_reason(self, world: World) -> None:
        loser, equal, chief = [await world.client(t) for t in (OPERATOR, LOCAL, ADMIN)]
        await lease(loser)
        assert await drive(loser, valid_for=60) == "completed"
        assert code(await lease(equal, take=True, reason="me too")) == "lease_held"
        assert code(await lease(chief)) == "lease_held"
        assert code(await lease(chief, take=True)) == "bad_request"
        assert code(await lease(chief, take=True, reason="by hand")) == "completed"
        reply = await loser.request("write", DRIVE, body=FORWARD)
        assert code(reply) == "lease_lost"
        details = reply["error"]["details"]
        assert (details["by"], details["reason"]) == ("admin", "by hand")
        assert await drive(chief) == "completed"

    @proves("control.told")
    async def test_a_loser_is_told(self, world: World) -> None:
        loser, chief = await world.client(OPERATOR), await world.client(ADMIN)
        held = (await lease(loser))["body"]
        await lease(chief, take=True, reason="by hand")
        notice = await loser.notice("lease_lost")
        assert (notice["lease"], notice["by"], notice["reason"]) == (
            held["lease"],
            "admin",
            "by hand",
        )

    @proves("control.age-in-queue")
    async def test_what_grows_old_in_a_queue_is_refused_at_its_turn(self, world: World) -> None:
        client, robot = await world.client(), world.robot()
        go: Message = {"type": "execute", "path": LINE}
        first = await client.send(go, body={"distance": 1.0, "mode": "wait"})
        await self._begun(world, 1)
        sent = time.time() - MAX_AGE + 1.0
        old = await client.send(go, body={"distance": 2.0}, timestamp=sent)
        fresh = await client.send(go, body={"distance": 3.0}, timestamp=time.time())
        await self._waiting(client, 2)
        await passed(sent + MAX_AGE)
        robot.release.set()
        assert code(await client.final(first)) == "completed"
        late = await client.final(old)
        assert (late["status"], code(late)) == ("rejected", "stale_command")
        assert code(await client.final(fresh)) == "completed"
        assert [value.distance for _, value in robot.ran] == [1.0, 3.0]

    @proves("control.estop-scope")
    async def test_an_estop_holds_a_robot_a_tenant_or_all(self, world: World) -> None:
        person, admin = await world.client(LOCAL), await world.client(ADMIN)
        alpha = {"main", "drone", "ghost"}
        for client, scope, held in (
            (person, {"scope": "drone"}, {"drone"}),
            (person, {"scope": "/tenant/alpha/drone1"}, {"drone"}),
            (admin, {"scope": "/tenant/beta"}, {"other"}),
            (admin, {"scope": "/tenant/alpha"}, alpha),
            (admin, {}, alpha | {"other"}),
        ):
            await estop(client, **scope)
            seen = (await admin.request("read", "/system/estop"))["body"]
            assert set(seen["robots"]) == held
            moves = "estop_active" if "main" in held else "completed"
            assert await drive(person) == moves
            assert code(await estop(admin, reset=True)) == "completed"
        assert [world.robot(n).halts for n in ("main", "drone", "other")] == [2, 4, 2]

        await estop(admin)
        await estop(admin, reset=True, scope="main")
        assert await drive(person) == "completed"
        seen = (await admin.request("read", "/system/estop"))["body"]
        assert set(seen["robots"]) == {"drone", "ghost", "other"}

    @proves("control.estop-reset")
    async def test_only_a_role_that_may_resets_it(self, world: World) -> None:
        admin = await world.client(ADMIN)
        await estop(admin, reason="smoke")
        for token in (None, VIEWER, OPERATOR, LOCAL):
            client = await world.client(token)
            refused = await estop(client, reset=True)
            assert code(refused) in ("forbidden", "unauthenticated")
        reply = await (await world.client(OPERATOR)).request("write", DRIVE, body=FORWARD)
        assert code(reply) == "estop_active"
        assert reply["error"]["details"]["reason"] == "smoke"
        assert code(await estop(admin, reset=True)) == "completed"

    @proves("control.estop-rest")
    async def test_nothing_goes_on_by_itself_after_a_reset(self, world: World) -> None:
        client, admin, robot = await world.client(), await world.client(ADMIN), world.robot()
        go: Message = {"type": "execute", "path": LINE}
        running = await client.send(go, body={"distance": 1.0, "mode": "wait"})
        await self._begun(world, 1)
        waiting = await client.send(go, body={"distance": 2.0})
        await self._waiting(client, 1)
        assert await drive(client, valid_for=0.3) == "completed"
        driven = time.time()

        await estop(admin)
        assert await drive(client) == "estop_active"
        before = time.time()
        assert code(await estop(admin, reset=True)) == "completed"
        for id_ in (running, waiting):
            assert code(await client.final(id_)) == "cancelled"
        await passed(driven + 0.4)
        assert await drive(client, timestamp=before) == "stale_command"
        assert robot.writes == [("actuator/drive", Twist(LinearVelocity(0.5)))]
        assert [value.distance for _, value in robot.ran] == [1.0]
        assert await drive(client, timestamp=time.time()) == "completed"
        assert code(await client.request("execute", LINE, body={"distance": 3.0})) == "completed"

    async def _begun(self, world: World, count: int) -> None:
        async def ran() -> bool:
            return len(world.robot().ran) == count

        await eventually(ran, "the robot runs it")

    async def _waiting(self, client: Client, count: int) -> None:
        async def listed() -> bool:
            reply = await client.request("read", "/system/commands")
            return [one["status"] for one in reply["body"]].count("pending") == count

        await eventually(listed, "they wait in the queue")
