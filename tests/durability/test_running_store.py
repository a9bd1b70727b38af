"""A store that is lost while its gateway runs is noticed, and a latch taken meanwhile survives."""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from durability.process import ADMIN, BOUND, Served, until
from kernel.world import kept_in, settled, world_of
from rcp_store.damage import find_damage
from rcp_store.file import beside
from rcp_store.latch_file import LatchFile
from rcpd.cli import main

DRIVE = "/tenant/alpha/actuator/cmd_vel"


def replaced(path: Path) -> None:
    copy = path.with_name("copy")
    shutil.copy(path, copy)
    copy.rename(path)


def cut(path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(0)


LOSSES: dict[str, tuple[Callable[[Path], None], str]] = {
    "deleted": (Path.unlink, "store.db was deleted"),
    "replaced": (replaced, "store.db was replaced"),
    "cut": (cut, "store.db was cut"),
    "wal deleted": (lambda path: path.with_name("store.db-wal").unlink(), "store.db-wal was "),
    "wal cut": (lambda path: cut(path.with_name("store.db-wal")), "store.db-wal was cut"),
}


@pytest.mark.anyio
@pytest.mark.parametrize("loss", LOSSES)
async def test_a_store_that_is_lost_is_noticed_and_nothing_moves(tmp_path: Path, loss: str) -> None:
    path = tmp_path / "store.db"
    lose, what = LOSSES[loss]
    async with world_of(kept_in(path)) as world:
        client = world.client(ADMIN)
        assert (await client.ask(type="status"))["body"]["state"] == "ok"
        await settled(world.server.gateway.store)
        lose(path)
        async with asyncio.timeout(BOUND):
            status: dict[str, Any] = {"state": "ok"}
            while status["state"] == "ok":  # until the store's thread has looked
                status = (await client.ask(type="status"))["body"]
        assert what in status["record"]["detail"]
        moved = await client.ask(type="write", path="/tenant/alpha/param/limit", body=1.0)
        assert moved["error"]["code"] == "queue_full"
        stop = await client.ask(type="execute", path="/system/estop", body={"reason": "smoke"})
        assert (stop["status"], world.robot.halts) == ("completed", 1)
        assert "not written yet" in stop["message"]
    async with world_of(kept_in(path)) as world:
        estop = (await world.client(ADMIN).ask(type="read", path="/system/estop"))["body"]
        assert "smoke" in estop["robots"]["robot"]["reason"]


@pytest.mark.anyio
async def test_a_head_file_that_is_deleted_is_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    async with world_of(kept_in(path)) as world:
        await settled(world.server.gateway.store)
        beside(path).unlink()
        async with asyncio.timeout(BOUND):
            while not beside(path).exists():
                await world.client().ask(type="write", path="/tenant/alpha/param/limit", body=1.0)
    assert find_damage(path) is None


def test_a_latch_taken_after_the_store_was_deleted_survives_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    served = Served(tmp_path, path)
    try:
        path.unlink()
        until(lambda: served.status()["state"] == "degraded")
        assert served.ask("PUT", DRIVE, {})["error"]["code"] == "queue_full"
        assert served.estop(scope="rover", reason="smoke")["status"] == "completed"
        until(lambda: "rover" in (LatchFile(path).read() or {}))
    finally:
        served.kill()
    served = Served(tmp_path, path)
    try:
        assert served.latched()
        assert served.status()["state"] == "degraded"
    finally:
        assert served.end() == 0


@pytest.fixture
def small_disk(tmp_path: Path) -> Generator[Path]:
    """A disk of 2 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = shutil.which("mount") is not None and os.geteuid() == 0
    options = ["-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)]
    if not mounted or subprocess.run(["mount", *options], check=False).returncode:
        pytest.skip("a disk can only be mounted by root")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(disk: Path) -> Path:
    """Leave no room on a disk."""
    ballast = disk / "ballast"
    with suppress(OSError), ballast.open("wb", buffering=0) as file:
        while file.write(b"\0" * 4096):
            pass
    return ballast


def test_a_latch_taken_on_a_full_disk_survives(tmp_path: Path, small_disk: Path) -> None:
    path = small_disk / "store.db"
    served = Served(tmp_path, path)
    try:
        ballast = fill(small_disk)
        until(lambda: served.estop(scope="rover", reset=True) and fill(small_disk).exists())
        until(lambda: served.status()["state"] == "degraded")
        assert "full" in served.status()["record"]["detail"]
        for number in range(3):  # in order: latched, reset, latched
            stop = served.estop(scope="rover", reason=f"smoke {number}", reset=number == 1)
            assert stop["status"] == "completed", stop
        until(lambda: (LatchFile(path).read() or {})["rover"]["reason"] == "smoke 2")
    finally:
        served.kill()
    ballast.unlink()
    served = Served(tmp_path, path)
    try:
        assert served.latched()
        assert served.status()["state"] == "ok"  # nothing that was committed is missing
    finally:
        assert served.end() == 0


def test_the_exit_code_tells_that_the_end_of_the_record_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    served = Served(tmp_path, path)
    try:
        path.unlink()
        until(lambda: served.status()["state"] == "degraded")
    finally:
        code = served.end()
    assert code == 3
    assert "rcpd: cannot write the store: the last audit records are lost" in served.text
    assert "Traceback" not in served.text


COMMANDS = (
    ["audit", "verify"],
    ["audit", "export"],
    ["token", "list", "--config"],
    ["token", "create", "anna", "--role", "viewer", "--config"],
    ["token", "revoke", "anna", "--config"],
    ["store", "check"],
    ["store", "backup", "/nowhere/copy.db"],
)


@pytest.mark.parametrize("size", [0, 4096])
def test_a_truncated_database_is_said_in_one_sentence(tmp_path: Path, size: int) -> None:
    path = tmp_path / "store.db"
    served = Served(tmp_path, path)
    served.estop(scope="rover", reason="smoke")
    assert served.end() == 0
    with path.open("r+b") as file:
        file.truncate(size)
    for words in COMMANDS:
        done = _run(*words, str(served.config))
        assert done.exit_code == 1, (words, done)
        [sentence] = done.stderr.splitlines()
        assert sentence.startswith("rcpd: "), done
    assert path.stat().st_size == size  # nothing of that has written it
    done = _run("check", str(served.config))
    assert done.exit_code == 0  # a gateway starts with it
    assert done.stderr.startswith("warning: the store is damaged: ")
    served = Served(tmp_path, path)
    try:
        assert served.latched()
        [record] = [line for line in served.text.splitlines() if "store_damaged" in line]
        assert "rcpd store repair" in record
        assert "Traceback" not in served.text
    finally:
        assert served.end() == 0
    assert _run("store", "repair", str(served.config)).exit_code == 0
    served = Served(tmp_path, path)
    try:
        assert served.status()["state"] == "ok"
        assert served.latched()
    finally:
        assert served.end() == 0


def _run(*words: str) -> Result:
    done = CliRunner().invoke(main, words)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done


def test_a_gateway_keeps_its_store_to_itself_while_it_runs(tmp_path: Path) -> None:
    served = Served(tmp_path, tmp_path / "store.db")
    try:
        for words in (["repair"], ["restore", str(tmp_path / "store.db")]):
            done = _run("store", *words, str(served.config))
            assert (done.exit_code, "Stop the other gateway" in done.stderr) == (1, True), done
    finally:
        assert served.end() == 0
