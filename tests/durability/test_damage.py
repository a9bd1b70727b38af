"""A damaged store is not a fresh one: every robot is latched, nothing is overwritten, and it is said."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from kernel.world import World, kept_in, settled, world_of
from rcp_store.damage import find_damage, interim_of
from rcp_store.file import open_read_only
from rcp_store.latch_file import latches_beside
from rcpd.cli import main
from rcpd.examination import examined

pytestmark = pytest.mark.anyio
LIMIT = "/tenant/alpha/param/limit"
ADMIN = "admin-admin-admin"
WRITES = 200
EVIDENCE = ("", "-wal", ".head")


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    return "asyncio"


async def fill(world: World) -> None:
    """Make the records of a day's work, then let the e-stop be pressed."""
    client = world.client()
    for number in range(WRITES):
        await client.ask(type="write", path=LIMIT, body=number / 100)
    await client.ask(type="execute", path="/system/estop", body={"reason": "smoke"})
    await settled(world.server.gateway.store)


@pytest.fixture(scope="module")
async def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a gateway that was stopped in an orderly way, with an e-stop latched."""
    path = tmp_path_factory.mktemp("stopped") / "store.db"
    async with world_of(kept_in(path)) as world:
        await fill(world)
    return path


@pytest.fixture(scope="module")
async def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `kill -9` leaves, most of it in the WAL."""
    source = tmp_path_factory.mktemp("running") / "store.db"
    path = tmp_path_factory.mktemp("killed") / "store.db"
    async with world_of(kept_in(source)) as world:
        await fill(world)
        for file in source.parent.iterdir():
            if not file.name.endswith(("-shm", ".lock")):
                shutil.copy(file, path.with_name(file.name))
    assert path.with_name("store.db-wal").stat().st_size > 100_000
    return path


def copied(source: Path, folder: Path, *, latches: bool = True) -> Path:
    """Copy the files of a store."""
    for file in source.parent.iterdir():
        if latches or ".latches" not in file.name:
            shutil.copy(file, folder / file.name)
    return folder / source.name


def only(folder: Path, pattern: str) -> Path:
    """Return the one file of a pattern."""
    [found] = folder.glob(pattern)
    return found


def cut(size: Callable[[int], int]) -> Callable[[Path], None]:
    """Return what truncates a database."""

    def damage(path: Path) -> None:
        with path.open("r+b") as file:
            file.truncate(size(path.stat().st_size))

    return damage


def overwritten(path: Path) -> None:
    path.write_bytes(b"\xa5" * path.stat().st_size)


def page_spoilt(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[4096 + 3 : 4096 + 5] = b"\xff\xff"  # the number of cells of a page
    path.write_bytes(data)


def tables_dropped(path: Path) -> None:
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("DROP TABLE audit")
        base.execute("DROP TABLE kept")


def end_deleted(path: Path) -> None:
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("DELETE FROM audit WHERE seq > 20")
        base.execute("DELETE FROM kept WHERE place = 'latches'")


def head_of_another(path: Path) -> None:
    head = path.with_name(path.name + ".head")
    head.write_text(f"{20:020d}:{'ab' * 32}\n")


def beside(suffix: str, how: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return what damages a file beside the database."""
    return lambda path: how(path.with_name(path.name + suffix))


DAMAGE: dict[str, Callable[[Path], None]] = {
    "emptied": cut(lambda _: 0),
    "one byte": cut(lambda _: 1),
    "half a header": cut(lambda _: 50),
    "header": cut(lambda _: 100),
    "first page": cut(lambda _: 4096),
    "half": cut(lambda size: size // 2),
    "half, whole pages": cut(lambda size: size // 8192 * 4096),
    "last page": cut(lambda size: size - 4096),
    "last byte": cut(lambda size: size - 1),
    "overwritten": overwritten,
    "page spoilt": page_spoilt,
    "deleted": Path.unlink,
    "tables dropped": tables_dropped,
    "end deleted": end_deleted,
    "head deleted": beside(".head", Path.unlink),
    "head garbage": beside(".head", lambda file: file.write_bytes(b"\xff" * 86)),
    "head emptied": beside(".head", lambda file: file.write_bytes(b"")),
    "head of another": head_of_another,
}
WAL_DAMAGE: dict[str, Callable[[Path], None]] = {
    "overwritten": overwritten,
    "emptied": cut(lambda _: 0),
    "header": cut(lambda _: 32),
    "half": cut(lambda size: size // 2),
    "deleted": Path.unlink,
}


async def holds_everything(path: Path) -> dict[str, Any]:
    """Start a gateway; see that it holds its robots and says why; return its status."""
    before = {
        suffix: path.with_name(path.name + suffix).read_bytes()
        for suffix in EVIDENCE
        if path.with_name(path.name + suffix).exists()
    }
    async with world_of(kept_in(path)) as world:
        admin = world.client(ADMIN)
        refused = await admin.ask(type="write", path="/tenant/alpha/actuator/drive", body={})
        assert refused["error"]["code"] == "estop_active", refused
        estop = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert estop["scopes"]["*"]["reason"].startswith("store damaged: ")
        assert estop["robots"]["robot"]["reason"].startswith("store damaged: ")
        status = (await admin.ask(type="status"))["body"]
        assert status["state"] == "degraded"
        assert status["record"]["detail"].startswith("store damaged: ")
        assert any("store_damaged" in str(warning) for warning in status["warnings"])
        assert world.robot.halts > 0
        # A person who may resets it as any other latch; the record of that goes on beside.
        await admin.ask(type="execute", path="/system/estop", body={"reset": True})
        moved = await admin.ask(type="write", path=LIMIT, body=1.0)
        assert moved["status"] == "completed", moved
        assert (await admin.ask(type="status"))["body"]["state"] == "degraded"
    for suffix, data in before.items():
        assert path.with_name(path.name + suffix).read_bytes() == data, f"{suffix} was changed"
    assert examined(interim_of(path)).findings == []
    return status


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("latches", [True, False])
async def test_a_damaged_store_holds_every_robot_until_a_person_resets_it(
    stopped: Path, tmp_path: Path, damage: str, *, latches: bool
) -> None:
    path = copied(stopped, tmp_path, latches=latches)
    DAMAGE[damage](path)
    await holds_everything(path)
    await holds_everything(path)  # at each start, until the store is repaired


@pytest.mark.parametrize("damage", WAL_DAMAGE)
async def test_a_lost_wal_is_damage(killed: Path, tmp_path: Path, damage: str) -> None:
    path = copied(killed, tmp_path)
    WAL_DAMAGE[damage](path.with_name("store.db-wal"))
    status = await holds_everything(path)
    assert "are missing" in status["record"]["detail"]


@pytest.mark.parametrize("source", ["killed", "stopped"])
async def test_what_a_kill_or_a_stop_leaves_is_not_damaged(
    killed: Path, stopped: Path, tmp_path: Path, source: str
) -> None:
    path = copied({"killed": killed, "stopped": stopped}[source], tmp_path)
    path.with_name("store.db-shm").write_bytes(b"\xa5" * 32768)  # made anew at each start
    async with world_of(kept_in(path)) as world:
        admin = world.client(ADMIN)
        estop = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert estop["robots"]["robot"]["reason"] == "smoke"
        assert (await admin.ask(type="status"))["body"]["state"] == "ok"
    assert not interim_of(path).exists()
    assert examined(path).findings == []


async def test_a_first_start_that_was_killed_leaves_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    path.with_name("store.db.head").touch()  # it had no time to write it
    async with world_of(kept_in(path)) as world:
        await fill(world)
    assert find_damage(path) is None
    assert examined(path).findings == []


async def test_an_older_copy_put_back_by_hand_is_not_taken_for_the_newest(
    stopped: Path, tmp_path: Path
) -> None:
    path = copied(stopped, tmp_path)
    older = tmp_path / "older"
    shutil.copy(path, older)
    async with world_of(kept_in(path)) as world:
        await world.client().ask(type="write", path=LIMIT, body=1.0)
    shutil.copy(older, path)
    status = await holds_everything(path)
    assert "older copy" in status["record"]["detail"]


async def test_a_power_cut_that_costs_the_last_records_latches_nothing_new(
    killed: Path, tmp_path: Path
) -> None:
    path = copied(killed, tmp_path)
    head = path.with_name("store.db.head")
    line = head.read_text(encoding="ascii").split()[0]
    head.write_text(f"{line} another-run-of-the-machine\n", encoding="ascii")
    cut(lambda size: size // 2)(path.with_name("store.db-wal"))
    async with world_of(kept_in(path)) as world:
        admin = world.client(ADMIN)
        assert (await admin.ask(type="status"))["body"]["state"] == "ok"
        estop = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert estop["scopes"]["*"]["reason"] == "smoke"  # from the latch file, which is flushed
    assert any("had been there before" in what for _, what in examined(path).findings)


@pytest.mark.parametrize(
    "content", [b"", b"\xff" * 100, b"{}", b'{"version":2,"sha256":"","latches":{}}']
)
async def test_a_damaged_latch_file_holds_every_robot(
    stopped: Path, tmp_path: Path, content: bytes
) -> None:
    path = copied(stopped, tmp_path)
    async with world_of(kept_in(path)) as world:
        await world.client(ADMIN).ask(type="execute", path="/system/estop", body={"reset": True})
    latches_beside(path).write_bytes(content)
    async with world_of(kept_in(path)) as world:
        admin = world.client(ADMIN)
        estop = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert "store.db.latches" in estop["robots"]["robot"]["reason"]
        await admin.ask(type="execute", path="/system/estop", body={"reset": True})
    aside = only(tmp_path, "store.db.latches.damaged-*")
    assert aside.read_bytes() == content
    async with world_of(kept_in(path)) as world:
        estop = (await world.client(ADMIN).ask(type="read", path="/system/estop"))["body"]
        assert not estop["active"]


async def test_a_changed_latch_is_a_damaged_latch_file(stopped: Path, tmp_path: Path) -> None:
    path = copied(stopped, tmp_path)
    file = latches_beside(path)
    file.write_bytes(file.read_bytes().replace(b"smoke", b"smoky"))
    async with world_of(kept_in(path)) as world:
        estop = (await world.client(ADMIN).ask(type="read", path="/system/estop"))["body"]
        assert "checksum" in estop["scopes"]["*"]["reason"]


async def test_either_place_alone_keeps_a_latch(stopped: Path, tmp_path: Path) -> None:
    path = copied(stopped, tmp_path)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("DELETE FROM kept WHERE place = 'latches'")
    for lost in (lambda: None, latches_beside(path).unlink):
        lost()
        async with world_of(kept_in(path)) as world:
            estop = (await world.client(ADMIN).ask(type="read", path="/system/estop"))["body"]
            assert estop["robots"]["robot"]["reason"] == "smoke"


def store(*words: str | Path, code: int = 0) -> str:
    """Run `rcpd store`; return what it says."""
    done = CliRunner().invoke(main, ["store", *map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert done.exit_code == code, done.output
    return done.output


def numbers(path: Path) -> list[int]:
    with closing(open_read_only(path)) as base:
        return [seq for (seq,) in base.execute("SELECT seq FROM audit ORDER BY seq")]


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("meanwhile", [True, False])
async def test_a_repair_recovers_what_can_be_read_and_says_what_is_missing(
    stopped: Path, tmp_path: Path, damage: str, *, meanwhile: bool
) -> None:
    path = copied(stopped, tmp_path)
    before = {seq: (hash_, data) for seq, hash_, data in _records(path)}
    last = max(before)
    DAMAGE[damage](path)
    if meanwhile:
        await holds_everything(path)
    said = store("repair", "--store", path)
    found = {seq: (hash_, data) for seq, hash_, data in _records(path)}
    missing = set(before) - set(found)
    interim = not meanwhile or "stays there" not in said
    recovered = {seq: row for seq, row in found.items() if seq <= last and row == before[seq]}
    if interim and damage != "head deleted":
        changed = 1 if damage == "last byte" else 0
        assert len(recovered) == len(before) - len(missing) - changed
        assert min(set(found) - set(before), default=0) in (last + 1, 1)
    assert f"{len(missing)} missing" in said or not interim
    verdict = examined(path)
    if not missing:
        assert verdict.findings == [] or damage in ("head of another", "last byte")
    else:
        assert f"({len(missing)}) were lost with a damaged store" in str(verdict.findings)
    aside = only(tmp_path, "store.db.damaged-*")
    assert find_damage(path) is None
    assert not interim_of(path).exists()
    assert (aside / "store.db").exists() or damage == "deleted"
    async with world_of(kept_in(path)) as world:
        admin = world.client(ADMIN)
        assert (await admin.ask(type="status"))["body"]["state"] == "ok"
        estop = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert estop["robots"]["robot"]["reason"].startswith("store repaired: ")
        await admin.ask(type="execute", path="/system/estop", body={"reset": True})
    assert "nothing to repair" in store("repair", "--store", path)


def _records(path: Path) -> list[tuple[int, bytes, bytes]]:
    with closing(open_read_only(path)) as base:
        return base.execute("SELECT seq, hash, record FROM audit ORDER BY seq").fetchall()
