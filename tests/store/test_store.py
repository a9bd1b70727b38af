"""What is put is there after a crash once it is settled, and a store that cannot write says so."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
from collections.abc import AsyncGenerator
from contextlib import closing
from pathlib import Path

import pytest

from kernel.world import BOUND, kept_in, settled, until_trouble, world_of
from rcp_kernel.errors import ConfigError
from rcp_store.disk_store import DiskStore
from rcp_store.file import create, open_writable
from rcp_store.latch_file import LatchFile, encode_latches, latch_row
from rcp_store.record_batch import Batch, commit
from rcp_store.store import Store

pytestmark = pytest.mark.anyio


@pytest.fixture
async def store(tmp_path: Path) -> AsyncGenerator[DiskStore]:
    made = DiskStore(tmp_path / "store.db", asyncio.get_running_loop())
    yield made
    made.close()


def crashed(store: DiskStore) -> DiskStore:
    """Open what a crash at this moment leaves."""
    copy = store.path.with_name("crashed.db")
    for suffix in (".head", "", "-wal"):
        shutil.copy(f"{store.path}{suffix}", f"{copy}{suffix}")
    return DiskStore(copy, asyncio.get_running_loop())


async def test_what_is_settled_survives_a_crash(store: DiskStore) -> None:
    store.put("things", "a", {"x": [1, "ä", b"\0"]})
    store.put("things", "b", 1)
    store.put("others", "a", 2)
    store.put("things", "b", None)
    await settled(store)
    later = crashed(store)
    assert later.load("things") == {"a": {"x": [1, "ä", b"\0"]}}
    assert later.load("others") == {"a": 2}
    later.close()


async def test_settled_calls_back_in_order_and_at_once_when_nothing_waits(store: DiskStore) -> None:
    received: list[int] = []
    store.settled(lambda: received.append(0))
    assert received == [0]
    for number in range(1, 4):
        store.put("things", str(number), number)
        store.settled(lambda number=number: received.append(number))
    assert received == [0]
    await settled(store)
    assert received == [0, 1, 2, 3]


async def test_a_locked_store_is_retried_and_loses_nothing(store: DiskStore) -> None:
    store.put("things", "a", 1)
    await settled(store)
    async with asyncio.timeout(BOUND):
        with closing(sqlite3.connect(store.path)) as other:
            other.execute("BEGIN IMMEDIATE")
            store.put("things", "b", 2)
            store.append((1, b"hash", b"record"))
            await until_trouble(store)
            assert store.waiting == 1
            other.rollback()
        await settled(store)
    assert store.trouble is None
    assert store.waiting == 0
    assert store.load("things") == {"a": 1, "b": 2}
    assert store.rows(5) == [(1, b"hash", b"record")]


async def test_a_second_gateway_on_the_same_store_is_refused(store: DiskStore) -> None:
    for _ in range(2):
        with pytest.raises(ConfigError, match=r"another gateway is using it\. Stop the other"):
            DiskStore(store.path, asyncio.get_running_loop())


def whole(path: Path) -> Path:
    """Make a store with something in it."""
    made = DiskStore(path, asyncio.get_running_loop())
    for number in range(100):
        made.put("things", f"{number}", "x" * 100)
    made.close()
    return path


async def test_no_start_where_nothing_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, pragma = whole(tmp_path / "store.db"), "query_only = 1"

    def limited(_store: DiskStore) -> sqlite3.Connection:
        base = open_writable(path)
        base.execute(f"PRAGMA {pragma}")
        return base

    monkeypatch.setattr(DiskStore, "_connect", limited)
    with pytest.raises(
        ConfigError,
        match=r"readonly database\. Use a folder that the "
        r"gateway's user",
    ):
        DiskStore(path, asyncio.get_running_loop())
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="Use a folder that the gateway's user"):
        DiskStore(tmp_path / "file" / "store.db", asyncio.get_running_loop())


async def test_no_start_while_another_program_holds_the_store(tmp_path: Path) -> None:
    path = whole(tmp_path / "store.db")
    with closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(ConfigError, match="Close the program that has it open"):
            DiskStore(path, asyncio.get_running_loop())
        other.rollback()


async def test_an_estop_whose_row_was_spoilt_is_still_latched(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        await world.client().ask(type="execute", path="/system/estop")
        await world.client().ask(
            type="execute", path="/system/leases", body={"do": "acquire", "scope": "/param"}
        )
    for value in (b"\xc1", b"\x01", "text", b"\x81\xa2by\x01", b"\x81\xa2by\xd4\x05\x00"):
        with closing(sqlite3.connect(path)) as base, base:
            base.execute(
                "UPDATE kept SET value = ? WHERE place IN ('latches', 'leases.held')", (value,)
            )
        async with world_of(kept_in(path)) as world:
            client = world.client()
            moved = await client.ask(type="execute", path="/tenant/alpha/action/go", body=1)
            assert moved["error"]["code"] == "estop_active"
            assert (await client.ask(type="read", path="/system/leases"))["body"] == []


async def test_a_store_is_for_its_owner_alone(store: DiskStore) -> None:
    assert store.path.stat().st_mode & 0o077 == 0


async def test_what_no_encoding_takes_is_left_out_and_the_rest_kept(store: DiskStore) -> None:
    store.put("things", "bad", object())
    store.put("things", "long", 10**30)
    await settled(store)
    assert store.load("things") == {"long": str(10**30)}


async def test_without_a_path_nothing_is_kept_and_everything_is_settled() -> None:
    store = Store()
    store.put("things", "a", 1)
    await settled(store)
    assert store.load("things") == {}


async def test_a_full_disk_is_waited_out(store: DiskStore, monkeypatch: pytest.MonkeyPatch) -> None:
    limited = True

    def small(path: Path) -> sqlite3.Connection:
        base = open_writable(path)
        base.execute("PRAGMA max_page_count = 20" if limited else "PRAGMA max_page_count = 9999")
        return base

    monkeypatch.setattr("rcp_store.disk_store.open_writable", small)
    store.put("things", "a", 1)
    async with asyncio.timeout(BOUND):
        for number in range(40):
            store.append((number + 1, b"hash", b"x" * 4096))
        assert "full" in await until_trouble(store)
        limited = False  # somebody made room
        await settled(store)
    assert store.trouble is None
    assert len(store.rows(100)) == 40


async def test_a_key_that_cannot_be_read_runs_nothing_again(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    limit = {"type": "write", "path": "/param/limit", "body": 1.0}
    for spoil in ("x'c1'", "x'80'"):  # no msgpack, and without what a key has
        key = {"idempotency_key": spoil}
        async with world_of(kept_in(path)) as world:
            assert (await world.client().ask(**limit, **key))["status"] == "completed"
        with closing(sqlite3.connect(path)) as base, base:
            base.execute(f"UPDATE kept SET value = {spoil} WHERE place = 'keys'")
        async with world_of(kept_in(path)) as world:
            reply = await world.client().ask(**limit, **key)
            assert (reply["status"], reply["error"]["code"]) == ("failed", "internal")
            assert "not sent again" in reply["error"]["message"]
            assert world.robot.writes == []
            assert (await world.client().ask(**limit))["status"] == "completed"


def test_latches_are_written_in_place_after_a_kill_between_two_renames(tmp_path: Path) -> None:
    """A full disk has room for no other file."""
    store = tmp_path / "store.db"
    file = LatchFile(store)
    for by in ("ann", "bob"):
        file.write(encode_latches({"rover": latch_row(by, "smoke")}))
    spare, swap = (tmp_path / f"store.db.latches.{name}" for name in ("spare", "swap"))
    spare.rename(swap)  # as the kill leaves it
    blocks = {path.stat().st_ino for path in (file.path, swap)}
    file.write(encode_latches({"rover": latch_row("cyd", "smoke")}))
    rows = LatchFile(store).read()
    assert rows is not None
    assert rows["rover"]["by"] == "cyd"
    assert {path.stat().st_ino for path in (file.path, spare)} == blocks
    assert not swap.exists()


@pytest.mark.parametrize("count", [1, 5, 64, 65, 200])
def test_rows_that_come_together_are_one_transaction(tmp_path: Path, count: int) -> None:
    with closing(writer_of(tmp_path / "store.db")) as base:
        said: list[str] = []
        base.set_trace_callback(said.append)
        batch = Batch()
        batch.rows = [(number, b"hash", b"record") for number in range(1, count + 1)]
        commit(base, batch)
        base.set_trace_callback(None)
        assert base.execute("SELECT count(*) FROM audit").fetchone() == (count,)
        inserted = sum(text.startswith("INSERT") for text in said)
        assert inserted == -(-count // 64)
        assert said.count("BEGIN") == (inserted > 1)
        assert not base.in_transaction


@pytest.mark.parametrize("puts", [{}, {("things", "a"): b"1", ("things", "b"): None}])
def test_of_a_batch_that_fails_nothing_is_kept(
    tmp_path: Path, puts: dict[tuple[str, str], bytes | None]
) -> None:
    with closing(writer_of(tmp_path / "store.db")) as base:
        base.execute("INSERT INTO kept VALUES ('things', 'b', x'02')")
        batch = Batch()
        batch.puts = puts
        batch.rows = [(1, b"hash", b"record"), (2, None, b"record")]  # pyright: ignore[reportAttributeAccessIssue]
        with pytest.raises(sqlite3.IntegrityError):
            commit(base, batch)
        assert not base.in_transaction
        assert base.execute("SELECT count(*) FROM audit").fetchone() == (0,)
        assert base.execute("SELECT key FROM kept").fetchall() == [("b",)]


def writer_of(path: Path) -> sqlite3.Connection:
    """Open a database as the thread of the store does."""
    create(path)
    base = open_writable(path)
    base.isolation_level = None
    return base
