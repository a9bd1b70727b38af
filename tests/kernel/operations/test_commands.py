"""The life of a command: every status follows from the life of one coroutine."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from kernel.world import World, kept_in, settled, world_of
from rcp_gateway.testing import SteppedClock

pytestmark = pytest.mark.anyio
GO = "/tenant/alpha/action/go"


async def test_a_command_is_accepted_reports_feedback_and_completes(world: World) -> None:
    client = world.client()
    id_ = client.send(type="execute", path=GO, body=4.0)
    assert (await client.until(lambda m: m["id"] == id_))["status"] == "accepted"
    feedback = await client.until(lambda m: m["status"] == "in_progress")
    assert (feedback["body"], feedback["progress"]) == (2.0, 0.5)
    world.robot.release.set()
    final = await client.final(id_)
    assert (final["status"], final["body"]) == ("completed", 4.0)
    assert final["message"] == f"Command {GO} executed successfully."
    assert final["command"] == feedback["command"]


@pytest.mark.parametrize(
    ("value", "status", "code"),
    [
        (13, "rejected", "device_rejected"),
        (14, "failed", "device_rejected"),
        (15, "failed", "internal"),
    ],
)
async def test_what_the_robot_makes_of_it_decides_the_final_status(
    world: World, value: int, status: str, code: str
) -> None:
    final = await world.client().ask(type="execute", path=GO, body=value)
    assert (final["status"], final["error"]["code"]) == (status, code)
    assert "ZeroDivision" not in str(final)


@pytest.mark.parametrize("value", [16, 17])
async def test_a_command_whose_link_is_lost_has_failed_and_is_not_to_be_repeated(
    world: World, value: int
) -> None:
    final = await world.client().ask(type="execute", path=GO, body=value)
    assert (final["status"], final["error"]["code"]) == ("failed", "adapter_unavailable")
    assert final["error"]["retryable"] is False


@pytest.mark.parametrize("how", ["down", "withdrawn", "deadline"])
async def test_a_command_that_the_robot_had_without_feedback_is_not_to_be_repeated(
    world: World, how: str
) -> None:
    robot, client = world.robot, world.client()
    robot.behaviours["action/go"] = robot.wait
    late = {"deadline": 0.2} if how == "deadline" else {}
    id_ = client.send(type="execute", path=GO, body=1, **late)
    await robot.started.get()
    if how == "down":
        robot.host.report("no message received for 4.2 s", down=True)
    elif how == "withdrawn":
        robot.remove("action/go")
    final = await client.final(id_)
    code = "deadline_exceeded" if how == "deadline" else "adapter_unavailable"
    assert (final["status"], final["error"]["code"]) == ("failed", code)
    assert final["error"]["retryable"] is False


async def test_a_queued_command_whose_backend_goes_down_may_be_repeated(world: World) -> None:
    robot, client = world.robot, world.client()
    path = "/tenant/alpha/action/wait_in_line"
    client.send(type="execute", path=path, body=1)
    second = client.send(type="execute", path=path, body=2)
    await robot.started.get()
    robot.host.report("no message received for 4.2 s", down=True)
    final = await client.final(second)
    assert (final["status"], final["error"]["retryable"]) == ("rejected", True)
    assert "on_loss" not in str(final)  # it was never with the robot
    assert robot.started.empty()


async def test_a_second_execute_is_rejected_while_the_first_runs(world: World) -> None:
    client = world.client()
    client.send(type="execute", path=GO, body=1)
    await world.robot.started.get()
    second = await client.ask(type="execute", path=GO, body=2)
    assert second["error"]["code"] == "already_running"
    assert second["message"] == (
        f"Warning: action '{GO}' is currently in progress; rejecting duplicate request."
    )


async def test_a_queued_command_waits_its_turn(world: World) -> None:
    client = world.client()
    path = "/tenant/alpha/action/wait_in_line"
    first = client.send(type="execute", path=path, body=1)
    second = client.send(type="execute", path=path, body=2)
    await client.until(lambda m: m["id"] == second and m["status"] == "pending")
    assert await world.robot.started.get() == 1
    assert world.robot.started.empty()
    world.robot.release.set()
    assert (await client.final(first))["status"] == "completed"
    assert (await client.final(second))["status"] == "completed"
    assert await world.robot.started.get() == 2


async def test_a_preempting_command_ends_the_one_before(world: World) -> None:
    client = world.client()
    path = "/tenant/alpha/action/cut_in"
    first = client.send(type="execute", path=path, body=1)
    await world.robot.started.get()
    second = client.send(type="execute", path=path, body=2)
    assert (await client.final(first))["status"] == "cancelled"
    assert await world.robot.started.get() == 2
    world.robot.release.set()
    assert (await client.final(second))["status"] == "completed"


@pytest.mark.parametrize("by", ["path", "command"])
async def test_a_cancel_reaches_the_robot_and_ends_the_command(world: World, by: str) -> None:
    client = world.client()
    id_ = client.send(type="execute", path=GO, body=1)
    accepted = await client.until(lambda m: m["id"] == id_)
    await world.robot.started.get()
    target = {"path": GO} if by == "path" else {"body": {"command": accepted["command"]}}
    assert (await client.ask(type="cancel", **target))["status"] == "completed"
    assert (await client.final(id_))["status"] == "cancelled"
    assert world.robot.stopped.qsize() == 1


async def test_a_deadline_ends_the_command_and_stops_the_robot(world: World) -> None:
    final = await world.client().ask(type="execute", path=GO, body=1, deadline=0.05)
    assert (final["status"], final["error"]["code"]) == ("failed", "deadline_exceeded")
    assert world.robot.stopped.qsize() == 1


async def test_a_key_seen_before_runs_nothing_again(world: World) -> None:
    client = world.client()
    world.robot.release.set()
    first = await client.ask(type="execute", path=GO, body=1, idempotency_key="k")
    again = await client.ask(type="execute", path=GO, body=1, idempotency_key="k")
    assert again["command"] == first["command"]
    assert world.robot.started.qsize() == 1
    other = await client.ask(type="execute", path=GO, body=2, idempotency_key="k")
    assert other["error"]["code"] == "duplicate_request"


async def test_a_write_under_a_key_is_made_once_even_while_it_is_under_way(world: World) -> None:
    client = world.client()
    path = "/tenant/alpha/param/limit"
    ids = [client.send(type="write", path=path, body=1.0, idempotency_key="w") for _ in range(3)]
    for id_ in ids:
        assert (await client.final(id_))["body"] == 1.0
    assert world.robot.writes == [("param/limit", 1.0)]


async def test_a_dry_run_checks_everything_and_changes_nothing(world: World) -> None:
    client = world.client()
    good = await client.ask(type="execute", path=GO, body=1, dry_run=True)
    assert (good["status"], good["dry_run"], good["body"]) == ("completed", True, {"execute": 1})
    bad = await client.ask(type="write", path="/param/limit", body=9, dry_run=True)
    assert bad["error"]["code"] == "out_of_range"
    assert world.robot.started.empty()
    assert world.robot.writes == []


async def test_a_command_outlives_its_connection(world: World) -> None:
    client = world.client()
    client.send(type="execute", path=GO, body=1)
    await world.robot.started.get()
    client.connection.close()
    world.robot.release.set()
    other = world.client()

    async def status() -> str:
        listed = await other.ask(type="read", path="/system/commands")
        return listed["body"][0]["status"]

    while await status() != "completed":
        assert world.robot.stopped.qsize() == 0


async def test_history_outlives_the_gateway_and_what_a_crash_cut_off_is_failed(
    tmp_path: Path,
) -> None:
    async with world_of(kept_in(tmp_path / "run.db")) as world:
        client = world.client()
        world.robot.release.set()
        await client.ask(type="execute", path=GO, body=1)
        world.robot.release.clear()
        client.send(type="execute", path=GO, body=2)
        await world.robot.started.get()
        await world.robot.started.get()
        await settled(world.server.gateway.store)
        # What is on disk now is all that a crash leaves.
        for suffix in (".head", "", "-wal"):
            shutil.copy(tmp_path / f"run.db{suffix}", tmp_path / f"crashed.db{suffix}")
    async with world_of(kept_in(tmp_path / "crashed.db")) as world:
        listed = (await world.client().ask(type="read", path="/system/commands"))["body"]
        assert [(c["input"], c["status"]) for c in listed] == [(2.0, "failed"), (1.0, "completed")]
        error = listed[0]["error"]
        assert "stopped while the command was running" in error["message"]
        assert "(on_loss = hold)" in error["message"]
        assert error["details"] == {"on_loss": "hold"}


async def test_a_row_that_cannot_be_read_is_left_out_of_the_history(tmp_path: Path) -> None:
    path = tmp_path / "rcp.sqlite3"
    text = kept_in(path)
    async with world_of(text) as world:
        world.robot.release.set()
        await world.client().ask(type="execute", path=GO, body=1)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("INSERT INTO kept VALUES ('commands', 'broken', x'ff00')")
        base.execute("INSERT INTO kept VALUES ('commands', 'odd', x'01')")
    async with world_of(text) as world:
        listed = (await world.client().ask(type="read", path="/system/commands"))["body"]
        assert [command["input"] for command in listed] == [1.0]


async def test_a_key_outlives_a_crash_with_its_outcome_or_the_news_that_it_has_none(
    tmp_path: Path,
) -> None:
    limit = "/tenant/alpha/param/limit"
    write = {"type": "write", "path": limit, "body": 1.0, "idempotency_key": "w"}
    done = {"type": "execute", "path": GO, "body": 1, "idempotency_key": "done"}
    cut = {"type": "execute", "path": GO, "body": 2, "idempotency_key": "cut"}
    async with world_of(kept_in(tmp_path / "run.db")) as world:
        client = world.client()
        world.robot.release.set()
        first = [await client.ask(**write), await client.ask(**done)]
        world.robot.release.clear()
        running = client.send(**cut)
        command = (await client.until(lambda m: m["id"] == running))["command"]
        await world.robot.started.get()
        await settled(world.server.gateway.store)
        for suffix in (".head", "", "-wal"):
            shutil.copy(tmp_path / f"run.db{suffix}", tmp_path / f"crashed.db{suffix}")
    async with world_of(kept_in(tmp_path / "crashed.db")) as world:
        client = world.client()
        again = [await client.ask(**write), await client.ask(**done)]
        for old, new in zip(first, again, strict=True):
            assert (new["status"], new["body"]) == (old["status"], old["body"])
            assert new.get("command") == old.get("command")
        refused = await client.ask(**{**write, "body": 2.0})
        assert refused["error"]["code"] == "duplicate_request"
        failed = await client.ask(**cut)
        assert (failed["status"], failed["command"]) == ("failed", command)
        assert "stopped while" in failed["error"]["message"]
        assert world.robot.writes == []
        assert world.robot.started.empty()


async def test_the_robot_hears_of_a_key_only_once_it_is_committed(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        await settled(world.server.gateway.store)
        client = world.client()
        world.robot.release.set()
        with closing(sqlite3.connect(path)) as other:
            other.execute("BEGIN IMMEDIATE")
            write = client.send(
                type="write", path="/param/limit", body=1.0, idempotency_key="w", deadline=0.2
            )
            execute = client.send(
                type="execute", path=GO, body=1, idempotency_key="e", deadline=0.2
            )
            for id_ in (write, execute):
                assert (await client.final(id_))["error"]["code"] == "deadline_exceeded"
            assert world.robot.writes == []
            assert world.robot.started.empty()
            other.rollback()


async def test_a_key_is_remembered_for_a_day(world: World, stepped: SteppedClock) -> None:
    client = world.client()
    write = {"type": "write", "path": "/param/limit", "body": 1.0, "idempotency_key": "k"}
    await client.ask(**write)
    stepped.advance(23 * 3600)
    await client.ask(**write)
    assert len(world.robot.writes) == 1
    stepped.advance(2 * 3600)
    await client.ask(**write)
    assert len(world.robot.writes) == 2


async def test_ended_commands_are_remembered_within_a_number_of_bytes(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_requests.journal._BYTES", 5000)
    client = world.client()
    for _ in range(10):
        await client.ask(type="execute", path="/tenant/alpha/service/echo", body="x" * 300)
    listed = (await client.ask(type="read", path="/system/commands"))["body"]
    assert len(listed) == 3  # of about 1.6 kB each
