"""Everything that matters is on record, in a chain that shows what was done to it."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
from click.testing import CliRunner

from configuration import backend, configuration, key
from kernel.world import BOUND, Client, World, kept_in, settled, until_trouble, world_of
from rcp_audit.throttle import DenialThrottle
from rcp_gateway.testing import SteppedClock
from rcpd.audit import audit
from rcpd.examination import examined

pytestmark = pytest.mark.anyio
LIMIT = "/tenant/alpha/param/limit"
GO = "/tenant/alpha/action/go"
TENANTS = configuration(
    backend(),
    backend("other", "beta"),
    key("ada", "admin-of-alpha-alone", role="admin", tenants=["alpha"]),
    key("bea", "admin-of-beta-viewer-of-alpha", roles={"alpha": "viewer", "beta": "admin"}),
    key("root", "admin-of-everything", role="admin"),
)


class Timers:
    """Stands for the loop: a test takes each timer, and calls it when it wants."""

    def __init__(self) -> None:
        self.waiting: list[Callable[[], None]] = []
        self.loop: Any = self

    def call_later(self, _delay: float, function: Callable[..., None], *given: Any) -> Any:
        self.waiting.append(partial(function, *given))
        return SimpleNamespace(cancel=lambda: None)

    def take(self) -> Callable[[], None]:
        """Take the timer that was set first."""
        return self.waiting.pop(0)


async def summaries(world: World) -> list[dict[str, Any]]:
    """Wait until refusals are summed up."""
    async with asyncio.timeout(BOUND):
        while not (found := await records(world, what="denials")):  # noqa: ASYNC110 - a timer writes
            await asyncio.sleep(0)
    return found


async def records(world: World, **wanted: Any) -> list[dict[str, Any]]:
    await settled(world.server.gateway.store)
    entry = world.server.gateway.registry.entries["/system/audit"]
    found = [sample.value for sample in entry.ring]
    return [r for r in found if all(r.get(key) == value for key, value in wanted.items())]


async def test_a_write_is_on_record_with_who_what_and_what_came_of_it(world: World) -> None:
    client = world.client()
    envelope = {"type": "write", "path": LIMIT, "idempotency_key": "k", "x-job": "night"}
    await client.ask(id="w-1", body=1.0, **envelope)
    [record] = await records(world, what="write")
    assert record["seq"] == 3
    assert {k: record[k] for k in ("principal", "roles", "proof", "tenant", "path", "outcome")} == {
        "principal": "operator",
        "roles": ["operator"],
        "proof": "key",
        "tenant": "alpha",
        "path": LIMIT,
        "outcome": "ok",
    }
    assert (record["id"], record["value"], record["x"]) == ("w-1", 1.0, {"x-job": "night"})
    assert (record["idempotency_key"], record["message"]) == ("k", f"{LIMIT} written.")
    assert client.connection.session.id.startswith(record["session"])
    assert len(record["session"]) == 8


async def test_a_write_to_a_stopped_robot_says_so_on_record(world: World) -> None:
    client = world.client()
    assert (await client.ask(type="write", path=LIMIT, body=1.0))["status"] == "completed"
    await client.ask(type="execute", path="/system/estop")
    assert (await client.ask(type="write", path=LIMIT, body=1.1))["status"] == "completed"
    assert (await client.ask(type="write", body={LIMIT: 1.2}))["status"] == "completed"
    told = [r.get("latched") for r in await records(world, what="write")]
    assert told == [None, True, True]


async def test_a_command_is_on_record_twice_with_what_the_robot_said(world: World) -> None:
    client = world.client()
    final = await client.ask(type="execute", path=GO, body=13)
    start, end = await records(world, command=final["command"])
    assert (start["what"], start["outcome"], start["value"]) == ("execute", "accepted", 13)
    assert (end["what"], end["status"], end["outcome"]) == (
        "command",
        "rejected",
        "device_rejected",
    )
    assert "bad luck" in end["message"]
    assert end["principal"] == "operator"
    world.robot.release.set()
    final = await client.ask(type="execute", path=GO, body=1)
    [end] = await records(world, command=final["command"], what="command")
    assert (end["status"], end["value"]) == ("completed", 1.0)


@pytest.mark.parametrize(
    ("envelope", "code"),
    [
        ({"type": "write", "path": LIMIT, "body": 1}, "forbidden"),
        ({"type": "write", "path": LIMIT, "body": 9}, "forbidden"),
        ({"type": "read", "path": "/system/sessions"}, "unknown_path"),
        ({"type": "subscribe", "path": "/system/audit"}, "unknown_path"),
        ({"type": "execute", "path": "/system/estop", "body": {"reset": True}}, "forbidden"),
    ],
)
async def test_a_refusal_is_on_record(world: World, envelope: dict[str, Any], code: str) -> None:
    client = world.client(None)
    reply = await client.ask(**envelope)
    assert reply["error"]["code"] == code
    [record] = await records(world, what="denial")
    assert (record["outcome"], record["request"]) == (code, envelope["type"])
    assert record["principal"] == "anonymous"
    assert record.get("value") == (envelope.get("body") if "body" in envelope else None)


async def test_an_operator_outside_the_bounds_of_a_value_is_on_record(world: World) -> None:
    await world.client().ask(type="write", path=LIMIT, body=9)
    [record] = await records(world, what="denial")
    assert (record["outcome"], record["value"]) == ("out_of_range", 9)


async def test_nothing_secret_gets_into_the_record(tmp_path: Path) -> None:
    async with world_of(kept_in(tmp_path / "store.db")) as world:
        client = world.client()
        hello = await client.ask(type="hello", body={"client": "c"})
        stolen = {"session": hello["body"]["session"], "resume_token": "wrong-resume-token"}
        other = world.client("admin-admin-admin")
        assert (await other.ask(type="hello", body=stolen))["error"]["code"] == "unauthenticated"
        refused = await world.client(None).ask(type="hello", body={"token": "no-such-token-at-all"})
        assert refused["error"]["code"] == "unauthenticated"
        with pytest.raises(Exception, match="unknown token"):
            world.client("no-such-token-at-all")
        denials = await records(world, what="denial", outcome="unauthenticated")
        assert len(denials) == 3
    held = (tmp_path / "store.db").read_bytes()
    for secret in (
        "operator-operator",
        "admin-admin-admin",
        "no-such-token",
        "wrong-resume",
        hello["body"]["resume_token"],
        hello["body"]["session"],
    ):
        assert secret.encode() not in held


async def test_a_long_value_is_told_by_its_length_and_hash(world: World) -> None:
    world.robot.release.set()
    await world.client().ask(type="execute", path="/tenant/alpha/service/echo", body="x" * 10_000)
    [start] = await records(world, what="execute")
    assert start["value"]["length"] == 10_002
    assert len(start["value"]["sha256"]) == 64


async def test_a_long_text_is_cut_but_a_value_is_told_whole(world: World) -> None:
    long = "x" * 600
    facts = {"message": long, "value": long, "name": "short"}
    world.server.gateway.event_bus.note("write", principal=None, path="/" + long, **facts)
    [found] = await records(world, what="write")
    assert (len(found["message"]), len(found["path"])) == (500, 500)
    assert (found["value"], found["name"]) == (long, "short")


async def test_what_the_log_fails_to_write_is_told_and_leaves_a_record_of_the_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any, **__: Any) -> NoReturn:
        raise ZeroDivisionError

    async with world_of(kept_in(tmp_path / "store.db")) as world:
        client = world.client()
        with monkeypatch.context() as patch:
            patch.setattr("rcp_audit.records.describe", broken)
            reply = await client.ask(type="write", path=LIMIT, body=1.0)
        assert reply["error"]["code"] == "deadline_exceeded"
        [gap] = await records(world, what="unrecorded")
        assert (gap["path"], gap["event"]) == (LIMIT, "write")
        assert gap["principal"] == "operator"
        status = (await client.ask(type="status"))["body"]
        assert (status["state"], status["record"]["state"]) == ("degraded", "degraded")
        assert "ZeroDivisionError" in status["record"]["detail"]


async def test_a_flood_of_refusals_becomes_one_record_a_window(
    world: World, stepped: SteppedClock
) -> None:
    client = world.client(None)
    for _ in range(50):
        await client.ask(type="write", path=LIMIT, body=1)
    assert len(await records(world, what="denial")) == 10
    stepped.advance(1)
    [summary] = await summaries(world)
    assert (summary["count"], summary["codes"]) == (40, {"forbidden": 40})
    assert summary["paths"] == {LIMIT: 40}
    assert summary["principal"] == "anonymous"
    await client.ask(type="write", path=LIMIT, body=1)  # the flood goes on: only counted
    assert len(await records(world, what="denial")) == 10


async def test_a_flood_in_two_tenants_is_summed_up_for_each_of_them(
    stepped: SteppedClock,
) -> None:
    async with world_of(TENANTS, clock=stepped.clock) as world:
        bea = world.client("admin-of-beta-viewer-of-alpha")
        paths = (LIMIT, "/tenant/beta/sensor/level")  # not hers to write; nothing to write at all
        for _ in range(12):
            for path in paths:
                await bea.ask(type="write", path=path, body=1)
        stepped.advance(1)
        sums = await summaries(world)
        assert [(s["tenant"], s["roles"], s["paths"]) for s in sums] == [
            ("alpha", ["viewer"], {paths[0]: 7}),
            ("beta", ["admin"], {paths[1]: 7}),
        ]


async def test_an_acknowledged_lease_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    ask = {"type": "execute", "path": "/system/leases"}
    body = {"do": "acquire", "scope": "/tenant/alpha/param"}
    async with world_of(kept_in(path)) as world:
        await settled(world.server.gateway.store)
        client = world.client()
        with closing(sqlite3.connect(path)) as other:
            other.execute("BEGIN IMMEDIATE")
            asked = client.send(**ask, body=body)
            await client.ask(type="ping")
            assert not [m for m in client.inbox if m["id"] == asked]
            other.rollback()
        assert (await client.final(asked))["body"]["scope"] == "/tenant/alpha/param"
        with closing(sqlite3.connect(path)) as other:
            [held] = other.execute("SELECT key FROM kept WHERE place = 'leases.held'").fetchall()
        assert (await client.ask(**ask, body={**body, "do": "release"}))["body"]["lease"] == held[0]


async def test_everybody_sees_the_records_of_their_tenants_alone() -> None:
    async with world_of(TENANTS) as world:
        ada, bea = (
            world.client("admin-of-alpha-alone"),
            world.client("admin-of-beta-viewer-of-alpha"),
        )
        root = world.client("admin-of-everything")
        for client in (ada, bea, root):
            await client.ask(
                type="subscribe", path="/system/audit", id="a", body={"qos": {"depth": 100}}
            )
        await ada.ask(type="write", path=LIMIT, body=1.0)
        await bea.ask(type="write", path="/tenant/beta/param/limit", body=1.1)
        await ada.ask(type="write", path="/tenant/beta/param/limit", body=1.2)
        await bea.ask(type="write", path=LIMIT, body=1.3)

        async def values(client: Client, count: int) -> list[Any]:
            seen: list[Any] = []
            while len(seen) < count:
                seen.append((await client.update("a"))["body"].get("value"))
            return seen

        assert [v for v in await values(root, 5) if v] == [1.0, 1.1, 1.2, 1.3]
        assert await values(ada, 3) == [1.0, 1.2, 1.3]
        # What bea is refused in alpha is alpha's, where her role does not show her the audit.
        assert await values(bea, 1) == [1.1]
        for client, last in ((ada, 1.3), (bea, 1.1), (root, 1.3)):
            await client.ask(type="ping")
            assert not [m for m in client.inbox if m["type"] == "update"]
            read = await client.ask(type="read", path="/system/audit")
            assert read["body"]["value"] == last
        past = await ada.ask(type="subscribe", path="/system/audit", id="p", body={"history": 100})
        assert past["status"] == "completed"
        told = [(await ada.update("p"))["body"] for _ in range(5)]
        assert [r["value"] for r in told if r["what"] != "login"] == [1.0, 1.2, 1.3]


async def test_the_record_goes_on_where_it_stopped_and_verifies(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    for _ in range(2):
        async with world_of(kept_in(path)) as world:
            await world.client().ask(type="write", path=LIMIT, body=1.0)
            status = await world.client("admin-admin-admin").ask(type="status")
            head = status["body"]["record"]["head"]
            assert "head" not in (await world.client().ask(type="status"))["body"]["record"]
            assert examined(path).findings == []
    verdict = examined(path)
    assert verdict.findings == []
    assert (verdict.count, verdict.first) == (12, 1)
    done = CliRunner().invoke(audit, ["verify", "--store", str(path), "--head", head])
    assert done.exit_code == 0, done.output
    assert "12 records, 1 to 12; head 12:" in done.output
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("DELETE FROM audit WHERE seq = 3")
    done = CliRunner().invoke(audit, ["verify", "--store", str(path)])
    assert done.exit_code == 1
    assert "record 3: missing" in done.output


async def test_records_are_exported_as_json_lines(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        client = world.client()
        await client.ask(type="write", path=LIMIT, body=1.0)
        await client.ask(type="write", path=LIMIT, body=9.0)

    def exported(*options: str) -> list[dict[str, Any]]:
        done = CliRunner().invoke(audit, ["export", "--store", str(path), *options])
        assert done.exit_code == 0, done.output
        return [json.loads(line) for line in done.output.splitlines()]

    everything = exported()
    assert [r["what"] for r in everything] == ["start", "login", "write", "denial", "stop"]
    assert [r["what"] for r in exported("--tenant", "alpha")] == ["write", "denial"]
    assert [r["seq"] for r in exported("--what", "write", "--what", "stop")] == [3, 5]
    middle = everything[3]["time"]
    assert [r["seq"] for r in exported("--since", middle)] == [4, 5]
    assert [r["seq"] for r in exported("--until", middle)] == [1, 2, 3]
    assert exported("--since", "2100-01-01") == []


async def test_old_records_are_deleted_and_the_chain_holds_from_there(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        for value in (1.0, 1.1, 1.2):
            await world.client().ask(type="write", path=LIMIT, body=value)
    async with world_of(kept_in(path) + "[audit]\nkeep_days = 1e-9\n") as world:
        admin = world.client("admin-admin-admin")
        await admin.ask(type="subscribe", path="/system/audit", body={"history": 100})
        pruned = await admin.until(lambda m: m["type"] == "update" and m["body"]["what"] == "prune")
        assert pruned["body"]["to"] >= 5
        await settled(world.server.gateway.store)
    verdict = examined(path)
    assert verdict.findings == []
    assert verdict.first > 5
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("DELETE FROM audit WHERE seq = ?", (verdict.first,))
    assert examined(path).findings


async def test_a_clock_that_is_far_ahead_deletes_no_record_before_a_day_has_passed(
    stepped: SteppedClock, tmp_path: Path
) -> None:
    text = kept_in(tmp_path / "store.db") + "[audit]\nkeep_days = 30\n"

    async def kept(world: World) -> int:
        store, found = world.server.gateway.store, list[int]()
        query = "SELECT min(seq) FROM audit"
        store.look(lambda base: base.execute(query).fetchone()[0], found.append)
        await settled(store)
        return found[0]

    async with world_of(text, clock=stepped.clock) as world:
        await world.client().ask(type="write", path=LIMIT, body=1.0)
        stepped.adjust(400 * 86_400)
        stepped.advance(100)
        await world.client().ask(type="write", path=LIMIT, body=1.1)
        assert await kept(world) == 1
    async with world_of(text, clock=stepped.clock) as world:
        stepped.adjust(400 * 86_400)  # once more, seen from the start on
    async with world_of(text, clock=stepped.clock) as world:
        stepped.advance(100)
        await world.client().ask(type="write", path=LIMIT, body=1.2)
        assert await kept(world) == 1
        stepped.advance(90_000)
        await until_pruned(world)
        assert await kept(world) > 5


async def until_pruned(world: World) -> None:
    """Wait until old records are deleted."""
    admin = world.client("admin-admin-admin")
    await admin.ask(type="subscribe", path="/system/audit", body={"history": 100})
    await admin.until(lambda m: m["type"] == "update" and m["body"]["what"] == "prune")


async def test_no_reply_leaves_before_its_record_is_committed(
    tmp_path: Path,
) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        await settled(world.server.gateway.store)
        client = world.client()
        with closing(sqlite3.connect(path)) as other:
            other.execute("BEGIN IMMEDIATE")
            held = client.send(type="write", path=LIMIT, body=1.0)
            late = client.send(type="write", path=LIMIT, body=1.1, deadline=0.3)
            told = await client.final(late)
            assert told["error"]["code"] == "deadline_exceeded"
            assert told["error"]["details"] == {"outcome": "completed"}
            assert ("param/limit", 1.0) in world.robot.writes  # it did not wait
            assert not [m for m in client.inbox if m["id"] == held]
            stop = await client.ask(type="execute", path="/system/estop")
            assert stop["status"] == "completed"
            assert world.robot.halts == 1
            other.rollback()
        assert (await client.final(held))["status"] == "completed"


async def test_what_cannot_go_on_record_is_refused_but_never_the_estop(tmp_path: Path) -> None:
    async with world_of(kept_in(tmp_path / "store.db")) as world:
        store = world.server.gateway.store
        await settled(store)
        with closing(sqlite3.connect(tmp_path / "store.db")) as other:
            other.execute("BEGIN IMMEDIATE")
            kernel = world.server.gateway
            for number in range(6000):
                kernel.event_bus.note("write", principal=None, number=number)
            client = world.client()
            for envelope in (
                {"type": "write", "path": LIMIT, "body": 1.0},
                {"type": "execute", "path": GO, "body": 1.0},
            ):
                refused = await client.ask(**envelope)
                assert refused["error"]["code"] == "queue_full"
                assert "audit log" in refused["error"]["message"]
                assert refused["error"]["retry_after"] == 1.0
            assert (await client.ask(type="read", path=LIMIT))["status"] == "completed"
            assert (await client.ask(type="execute", path="/system/estop"))["status"] == "completed"
            assert world.robot.halts == 1
            other.rollback()
        await settled(store)
        assert store.trouble is None
        text = {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
        await world.client("admin-admin-admin").ask(**text)
        assert (await client.ask(type="write", path=LIMIT, body=1.0))["status"] == "completed"
    assert examined(tmp_path / "store.db").findings == []


async def test_the_oldest_records_go_while_the_store_is_too_large(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    text = kept_in(path) + "[audit]\nkeep_mb = 1\n"
    async with world_of(text) as world:
        kernel = world.server.gateway
        for number in range(2000):
            kernel.event_bus.note("write", principal=None, number=number, message="x" * 500)
    assert path.stat().st_size > 1_000_000
    async with world_of(text) as world:
        admin = world.client("admin-admin-admin")
        await admin.ask(type="subscribe", path="/system/audit", body={"history": 100})
        await admin.until(lambda m: m["type"] == "update" and m["body"]["what"] == "prune")
        await settled(world.server.gateway.store)
    verdict = examined(path)
    assert verdict.findings == []
    assert 500 < verdict.count < 1900
    assert verdict.head[0] > 2000


async def test_a_store_that_cannot_be_written_makes_the_gateway_degraded(tmp_path: Path) -> None:
    async with world_of(kept_in(tmp_path / "store.db")) as world:
        store = world.server.gateway.store
        admin = world.client("admin-admin-admin")
        assert (await admin.ask(type="status"))["body"]["state"] == "ok"
        await settled(store)  # the login of the admin too
        with closing(sqlite3.connect(tmp_path / "store.db")) as other:
            other.execute("BEGIN IMMEDIATE")
            world.server.gateway.event_bus.note("login", principal=None)
            await until_trouble(store)
            status = (await admin.ask(type="status"))["body"]
            assert status["state"] == "degraded"
            assert status["record"]["state"] == "degraded"
            assert status["record"]["waiting"] == 1
            assert "locked" in status["record"]["detail"]
            client = world.client()
            for envelope in ({"type": "write", "path": LIMIT}, {"type": "execute", "path": GO}):
                refused = await client.ask(**envelope, body=1.0)
                assert refused["error"]["code"] == "queue_full"
                assert "locked" in refused["error"]["message"]
            assert world.robot.writes == []
            stop = await client.ask(type="execute", path="/system/estop")
            assert (stop["status"], world.robot.halts) == ("completed", 1)
            assert "not written yet" in stop["message"]
            other.rollback()
        await settled(store)
        assert (await admin.ask(type="status"))["body"]["state"] == "ok"


async def test_a_record_that_was_cut_off_between_two_runs_is_missed(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        await world.client().ask(type="write", path=LIMIT, body=1.0)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("DELETE FROM audit WHERE seq >= 2")
    assert examined(path).findings[0][0] == 2
    async with world_of(kept_in(path)):
        pass  # goes on beside it, after the last record that there was
    verdict = examined(path.with_name(path.name + ".interim"))
    assert (verdict.first, verdict.findings) == (5, [])
    assert examined(path).findings == [(2, "missing: the head is record 4")]


async def test_a_lapsed_command_and_the_stop_that_follows_are_on_record(world: World) -> None:
    client = world.client()
    drive = "/tenant/alpha/actuator/drive"
    body = {"linear": {"x": 1.0}}
    await client.ask(type="write", path=drive, body=body, valid_for=0.02)
    id_ = client.send(type="subscribe", path=drive)
    await client.until(
        lambda m: m.get("id") == id_ and m["type"] == "update" and m["body"]["linear"]["x"] == 0
    )
    lapsed, stopped = await records(world, what="deadman")
    assert (lapsed["outcome"], stopped["outcome"]) == ("lapsed", "ok")
    assert lapsed["path"] == stopped["path"] == drive
    assert stopped["value"]["linear"]["x"] == 0
    assert stopped["tenant"] == "alpha"


def test_a_flood_that_is_told_of_while_its_window_closes_has_one_window() -> None:
    timers, told = Timers(), list[dict[str, Any]]()

    def tell(facts: dict[str, Any]) -> None:
        told.append(facts)
        flood.passes("=who", {}, "/path", "forbidden", full=True)

    flood = DenialThrottle(timers.loop, 0, tell)
    flood.passes("=who", {}, "/path", "forbidden")
    first = timers.take()
    first()
    assert len(told) == 1
    second = timers.take()
    assert timers.waiting == []
    first()  # that window has been closed
    assert len(told) == 1
    second()
    assert len(told) == 2
    timers.take()
    assert timers.waiting == []
