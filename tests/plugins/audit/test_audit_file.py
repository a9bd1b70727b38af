"""Whatever single byte of a store is changed, its record is as it was or `verify` says so."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from kernel.world import kept_in, settled, world_of
from rcp_kernel.errors import ConfigError
from rcp_store.chain import Row
from rcp_store.file import ROWS, open_read_only
from rcpd.audit import audit
from rcpd.examination import examined

LIMIT = "/tenant/alpha/param/limit"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record whose beginning was deleted, as retention does."""
    path = tmp_path_factory.mktemp("record") / "store.db"

    async def live() -> None:
        async with world_of(kept_in(path)) as world:
            for _ in range(8):
                await world.client().ask(type="write", path=LIMIT, body=1.0)
        async with world_of(kept_in(path) + "[audit]\nkeep_days = 1e-9\n") as world:
            store = world.server.gateway.store
            done = asyncio.Event()
            store.look(lambda _base: None, lambda _found: done.set())
            await done.wait()  # the first look for what is too old came before it
            await settled(store)
        async with world_of(kept_in(path)) as world:
            for _ in range(8):
                await world.client().ask(type="write", path=LIMIT, body=1.0)

    asyncio.run(live())
    verdict = examined(path)
    assert verdict.findings == []
    assert verdict.first > 8
    assert verdict.count > 8
    return path


def rows(path: Path) -> list[Row]:
    with closing(open_read_only(path)) as base:
        return base.execute(f"{ROWS} ORDER BY seq").fetchall()


def spoilt(kept: Path, how: Callable[[Path], None]) -> bool:
    """Spoil a copy; tell whether that is found, and fail if it is not although it should be."""
    with TemporaryDirectory(dir=kept.parent) as folder:
        path = Path(folder) / kept.name
        for suffix in ("", ".head"):
            shutil.copy(f"{kept}{suffix}", f"{path}{suffix}")
        how(path)
        try:
            findings = examined(path).findings
        except ConfigError:
            return True
        assert findings or rows(path) == rows(kept)
        return bool(findings)


@settings(max_examples=300)
@given(data=st.data())
def test_any_changed_byte_of_the_file_is_found_or_bears_on_no_record(
    kept: Path, data: st.DataObject
) -> None:
    place = data.draw(st.integers(0, kept.stat().st_size - 1))
    change = data.draw(st.integers(1, 255))

    def flip(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[place] ^= change
        path.write_bytes(content)

    spoilt(kept, flip)


@settings(max_examples=60)
@given(data=st.data())
def test_any_single_change_to_the_rows_is_found(kept: Path, data: st.DataObject) -> None:
    numbers = [seq for seq, _, _ in rows(kept)]
    seq = data.draw(st.sampled_from(numbers))
    what = data.draw(
        st.sampled_from(
            [
                "DELETE FROM audit WHERE seq = ?",
                "DELETE FROM audit WHERE seq >= ?",
                "DELETE FROM audit WHERE seq <= ?",
                "UPDATE audit SET seq = -seq WHERE seq = ?",
                "UPDATE audit SET record = record || ' ' WHERE seq = ?",
                "UPDATE audit SET hash = 'text' WHERE seq = ?",
                "UPDATE audit SET hash = zeroblob(32) WHERE seq = ?",
                "INSERT INTO audit SELECT -1, hash, record FROM audit WHERE seq = ?",
                "DELETE FROM kept WHERE place = 'audit' AND ? > 0",
                "UPDATE kept SET value = x'c1' WHERE place = 'audit' AND ? > 0",
            ]
        )
    )

    def change(path: Path) -> None:
        with closing(sqlite3.connect(path)) as base, base:
            base.execute(what, (seq,))

    assert spoilt(kept, change), what


def test_whatever_became_of_the_file_it_is_said_in_a_line(kept: Path) -> None:
    content = kept.read_bytes()
    path = kept.with_name("halved.db")
    for size in range(0, len(content), 1000):
        path.write_bytes(content[:size])
        for command in ("verify", "export"):
            done = CliRunner().invoke(audit, [command, "--store", str(path)])
            assert done.exception is None or isinstance(done.exception, SystemExit)
        with suppress(FileNotFoundError):
            path.with_name(path.name + "-shm").unlink()
