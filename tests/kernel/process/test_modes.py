"""The store is its owner's alone: others who may write it keep it shut, readers are told of."""

from __future__ import annotations

import asyncio
import os
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner
from structlog.testing import capture_logs

from kernel.world import settled
from rcp_gateway.log import configure
from rcp_kernel.errors import ConfigError
from rcp_store.disk_store import DiskStore
from rcp_store.modes import check_store_modes
from rcp_store.tokens import TokenFile
from rcpd.tokens import token

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(os.name == "nt", reason="Windows has other rights"),
]
FILES = ["", ".head", ".lock", ".latches", "-wal", "-shm"]


@pytest.fixture
def store(tmp_path: Path) -> Path:
    path = tmp_path / "store.db"
    with closing(TokenFile(path)):
        pass
    return path


def modes(folder: Path) -> dict[str, int]:
    return {file.name: file.stat().st_mode & 0o777 for file in folder.iterdir()}


async def test_whatever_the_gateway_makes_is_its_owners_alone(tmp_path: Path) -> None:
    path = tmp_path / "state" / "store.db"
    before = os.umask(0)
    try:
        store = DiskStore(path, asyncio.get_running_loop())
        store.put("things", "a", 1)
        await settled(store)
        with closing(TokenFile(path)) as table:
            table.create("arm", (("*", ("viewer",)),), None)
            found = modes(path.parent)
        store.close()
    finally:
        os.umask(before)
    assert {f"store.db{suffix}" for suffix in FILES} <= set(found)
    assert set(found.values()) == {0o600}
    assert modes(tmp_path) == {"state": 0o700}


@pytest.mark.parametrize("suffix", FILES)
@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_may_write_is_refused(store: Path, suffix: str, mode: int) -> None:
    file = store.with_name(store.name + suffix)
    file.touch()
    file.chmod(mode)
    with pytest.raises(ConfigError, match=f"chmod 600 {file}"):
        check_store_modes(store)


async def test_nothing_opens_a_store_that_others_may_write(store: Path) -> None:
    allow(store, 0o660)
    with pytest.raises(ConfigError, match="other users can write"):
        TokenFile(store)
    with pytest.raises(ConfigError, match="other users can write"):
        DiskStore(store, asyncio.get_running_loop())
    done = CliRunner().invoke(token, ["list", "--store", str(store)])
    assert (done.exit_code, done.stdout) == (1, "")
    assert f"`chmod 600 {store}`" in done.stderr


def allow(file: Path, mode: int) -> None:
    file.chmod(mode)


@pytest.mark.parametrize(("mode", "warned"), [(0o640, True), (0o604, True), (0o600, False)])
async def test_a_store_that_others_may_read_is_told_of(
    store: Path,
    mode: int,
    warned: bool,  # noqa: FBT001 - a case
) -> None:
    allow(store, mode)
    message = (
        f"other users can read '{store}', which contains the audit log: run `chmod 600 {store}`"
    )
    configure("warning", "json")
    with capture_logs() as said:
        DiskStore(store, asyncio.get_running_loop()).close()
    assert [one["message"] for one in said if one["event"] == "store_readable"] == [
        message
    ] * warned
    made = CliRunner().invoke(token, ["create", "a", "--role", "viewer", "--store", str(store)])
    assert made.exit_code == 0
    assert (f"rcpd: {message}\n" in made.stderr) is warned
    assert made.stdout.startswith("rcp_")  # what is piped elsewhere is the key alone
