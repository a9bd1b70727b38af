"""A backup is made while the gateway writes, holds one moment as a whole, and can be put back."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from durability.process import ADMIN, BOUND, RCPD
from kernel.world import World, kept_in, settled, world_of
from rcp_store.chain import parse_head
from rcp_store.file import beside, head_beside, open_read_only
from rcp_store.tokens import TokenFile
from rcpd.cli import main
from rcpd.examination import examined

pytestmark = pytest.mark.anyio
LIMIT = "/tenant/alpha/param/limit"
RECORDS = 20_000  # in the store before the backup begins, so that it takes its time
BURST = 50  # records put at once
LATE = 2.0  # s a commit may take beside a backup, on a machine that is busy otherwise


def store(*words: str | Path, code: int = 0) -> str:
    """Run `rcpd store`; return what it says."""
    done = CliRunner().invoke(main, ["store", *map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert done.exit_code == code, done.output
    return done.output


async def wrote(world: World, value: float) -> None:
    done = await world.client().ask(type="write", path=LIMIT, body=value)
    assert done["status"] == "completed", done.get("error") or done
    await settled(world.server.gateway.store)


async def stop_and_reset(world: World) -> None:
    """Latch an e-stop, and reset it."""
    admin = world.client(ADMIN)
    for reset in (False, True):
        body = {"reset": reset}
        done = await admin.ask(type="execute", path="/system/estop", body=body, deadline=BOUND)
        assert done["status"] == "completed", done.get("error") or done


def names(folder: Path, pattern: str) -> list[str]:
    """List files."""
    return sorted(file.name for file in folder.glob(pattern))


async def latched(world: World) -> Any:
    """Return why the robot is latched, or None."""
    estop = (await world.client(ADMIN).ask(type="read", path="/system/estop"))["body"]
    return estop["robots"].get("robot", {}).get("reason")


@pytest.mark.serial
async def test_a_backup_under_load_is_whole_and_holds_nobody_up(tmp_path: Path) -> None:
    path, file = tmp_path / "store.db", tmp_path / "backup.db"
    async with world_of(kept_in(path)) as world:
        events, kept = world.server.gateway.event_bus, world.server.gateway.store
        for number in range(RECORDS):
            events.note("login", principal=None, message="x" * 400, number=number)
        await settled(kept)
        before = kept.head
        command = [RCPD, "store", "backup", str(file), "--store", str(path)]
        backup = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
        ended = asyncio.ensure_future(backup.communicate())
        loop, worst, bursts = asyncio.get_running_loop(), 0.0, 0
        async with asyncio.timeout(4 * BOUND):
            while not ended.done():
                for _ in range(BURST):
                    events.note("login", principal=None, message="y" * 400)
                began = loop.time()
                await settled(kept)
                worst, bursts = max(worst, loop.time() - began), bursts + 1
        said = (await ended)[0].decode()
        assert backup.returncode == 0, said
        after = kept.head
    print(f"worst commit {worst * 1000:.0f} ms in {bursts} bursts", file=sys.stderr)  # noqa: T201
    assert worst < LATE
    with closing(sqlite3.connect(file)) as base:
        assert base.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    verdict = examined(file)
    assert verdict.findings == []
    assert before[0] <= verdict.head[0] <= after[0]
    assert parse_head(said.split()[-1]) == verdict.head == head_beside(file)
    assert bursts > 10
    whole = examined(path)  # nothing was lost meanwhile
    assert (whole.findings, whole.count > after[0] - 1) == ([], True)
    assert names(tmp_path, "backup*") == ["backup.db", "backup.db.head"]
    assert file.stat().st_mode & 0o077 == 0


async def test_a_restore_goes_back_and_adds_the_records_that_came_later(tmp_path: Path) -> None:
    path, file = tmp_path / "store.db", tmp_path / "backup.db"
    async with world_of(kept_in(path)) as world:
        await stop_and_reset(world)
        await wrote(world, 1.0)
        store("backup", file, "--store", path)
        await wrote(world, 2.0)
    last = examined(path).head[0]
    said = store("restore", file, "--store", path)
    assert " 0 missing" in said
    verdict = examined(path)
    assert (verdict.findings, verdict.head[0]) == ([], last + 1)
    async with world_of(kept_in(path)) as world:
        status = (await world.client(ADMIN).ask(type="status"))["body"]
        assert status["state"] == "ok"
        assert str(await latched(world)).startswith("store restored from backup.db")
        await stop_and_reset(world)
        assert await latched(world) is None


async def test_a_restore_of_a_destroyed_store_says_how_many_records_are_missing(
    tmp_path: Path,
) -> None:
    path, file = tmp_path / "store.db", tmp_path / "backup.db"
    async with world_of(kept_in(path)) as world:
        await wrote(world, 1.0)
        store("backup", file, "--store", path)
        ends = examined(file).head[0]
        await wrote(world, 2.0)
    last = examined(path).head[0]
    path.write_bytes(b"\xa5" * path.stat().st_size)
    async with world_of(kept_in(path)) as world:  # goes on beside it
        await stop_and_reset(world)
        await wrote(world, 2.5)
    assert f"{last - ends} missing" in store("restore", file, "--store", path)
    verdict = examined(path)
    [(first, what)] = verdict.findings
    assert first == ends + 1
    assert (
        what == f"missing: records {ends + 1}…{last} ({last - ends}) were lost with a damaged store"
    )
    with closing(open_read_only(path)) as base:
        records = [row[0].decode() for row in base.execute("SELECT record FROM audit")]
    assert sum('"value":2.5' in record for record in records) == 1  # what was recorded meanwhile
    async with world_of(kept_in(path)) as world:
        assert (await world.client(ADMIN).ask(type="status"))["body"]["state"] == "ok"
        assert str(await latched(world)).startswith("store restored from backup.db")


async def test_a_restore_takes_no_damaged_backup_and_none_of_another_store(tmp_path: Path) -> None:
    path, other = tmp_path / "store.db", tmp_path / "other.db"
    for one in (path, other):
        async with world_of(kept_in(one)) as world:
            await wrote(world, 1.0)
    before = path.read_bytes()
    file, bad = tmp_path / "backup.db", tmp_path / "bad.db"
    store("backup", file, "--store", other)
    assert "another store" in store("restore", file, "--store", path, code=1)
    shutil.copy(file, bad)
    shutil.copy(f"{file}.head", f"{bad}.head")
    bad.write_bytes(bad.read_bytes()[:-4096])
    assert "is damaged" in store("restore", bad, "--store", path, code=1)
    assert "already exists" in store("backup", file, "--store", path, code=1)
    assert path.read_bytes() == before


async def test_a_key_that_was_revoked_after_the_backup_stays_revoked(tmp_path: Path) -> None:
    path, file = tmp_path / "store.db", tmp_path / "backup.db"
    async with world_of(kept_in(path)) as world:
        await wrote(world, 1.0)

    def token(*words: str) -> str:
        done = CliRunner().invoke(main, ["token", *words, "--store", str(path)])
        assert done.exit_code == 0, done.output
        return done.output

    token("create", "anna", "--role", "viewer")
    store("backup", file, "--store", path)
    token("revoke", "anna")
    store("restore", file, "--store", path)
    assert "anna" not in token("list")


async def test_check_looks_at_every_page_and_record(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        await wrote(world, 1.0)
        assert ": ok; " in store("check", "--store", path)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("UPDATE audit SET record = record || ' ' WHERE seq = 2")
    assert "damaged" in store("check", "--store", path, code=1)


@pytest.mark.parametrize("command", ["store check", "store backup copy", "audit verify"])
def test_a_store_that_no_gateway_has_served_yet_is_told(tmp_path: Path, command: str) -> None:
    path = tmp_path / "store.db"
    told = [*command.split(), "--store", str(path)]

    def refusal() -> str:
        done = CliRunner().invoke(main, told)
        assert done.exit_code == 1
        return done.output

    assert f"'{path}' does not exist; a gateway creates it" in refusal()
    with closing(TokenFile(path)) as table:
        table.create("arm", (("*", ("operator",)),), None)
    assert f"'{path}' has no audit log yet; a gateway adds it" in refusal()
    beside(path).write_text(f"7:{'ab' * 32}")  # there has been one
    assert "damaged" in refusal() or "run `rcpd store check`" in refusal()
