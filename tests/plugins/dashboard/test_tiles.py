"""Tiles of the map: an archive that is read in ranges, by whoever may load the pages."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import httpx
import pytest

from rcp_dashboard.tiles import Tiles
from rcp_kernel.errors import ConfigError
from transports.robot import site

pytestmark = pytest.mark.anyio
ARCHIVE = b"PMTiles\x03" + bytes(range(256)) * 1200  # more than one piece


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """Make something that begins as an archive does."""
    made = tmp_path / "field.pmtiles"
    made.write_bytes(ARCHIVE)
    return made


@pytest.fixture
async def stranger(static: object, archive: Path) -> AsyncGenerator[httpx.AsyncClient]:
    """Ask without a key."""
    more = f'[plugins.dashboard]\ntiles = "{archive}"\n'
    async with site(more=more) as gateway, httpx.AsyncClient(base_url=gateway.url) as client:
        yield client


async def test_ranges_of_the_archive_are_served(stranger: httpx.AsyncClient) -> None:
    assert (await stranger.get("/dashboard/map")).json() == {"tiles": True}
    for wanted, start, stop in (
        ("bytes=0-16383", 0, 16_384),
        ("bytes=300000-", 300_000, len(ARCHIVE)),
        ("bytes=-7", len(ARCHIVE) - 7, len(ARCHIVE)),
        ("bytes=5-9999999", 5, len(ARCHIVE)),
        ("bytes=5-" + 18 * "9", 5, len(ARCHIVE)),
    ):
        part = await stranger.get("/dashboard/map/tiles", headers={"range": wanted})
        assert part.status_code == 206, wanted
        place = f"bytes {start}-{stop - 1}/{len(ARCHIVE)}"
        assert part.headers["content-range"] == place
        assert part.content == ARCHIVE[start:stop]
    whole = await stranger.get("/dashboard/map/tiles")
    assert (whole.status_code, whole.content) == (200, ARCHIVE)
    head = await stranger.head("/dashboard/map/tiles")
    assert head.headers["content-length"] == str(len(ARCHIVE))
    etag = whole.headers["etag"]
    again = await stranger.get("/dashboard/map/tiles", headers={"if-none-match": etag})
    assert again.status_code == 304
    past = await stranger.get("/dashboard/map/tiles", headers={"range": "bytes=9999999-"})
    assert past.status_code == 416
    assert past.headers["content-range"] == f"bytes */{len(ARCHIVE)}"
    for long in ("bytes=0-" + 5000 * "9", "bytes=" + 5000 * "9" + "-", "bytes=-" + 5000 * "9"):
        odd = await stranger.get("/dashboard/map/tiles", headers={"range": long})
        assert (odd.status_code, odd.content) == (200, ARCHIVE)


async def test_an_archive_may_be_replaced_and_be_missed(
    stranger: httpx.AsyncClient, archive: Path
) -> None:
    etag = (await stranger.get("/dashboard/map/tiles")).headers["etag"]
    await asyncio.to_thread(archive.write_bytes, ARCHIVE[:9000])
    changed = {"range": "bytes=0-9", "if-range": etag}
    other = await stranger.get("/dashboard/map/tiles", headers=changed)
    assert (other.status_code, len(other.content)) == (200, 9000)
    assert other.headers["etag"] != etag
    await asyncio.to_thread(archive.unlink)
    gone = await stranger.get("/dashboard/map/tiles")
    assert (gone.status_code, gone.json()["error"]["code"]) == (404, "unknown_path")


async def test_what_is_sent_is_of_one_archive_though_it_is_replaced_meanwhile(
    archive: Path, tmp_path: Path
) -> None:
    tiles = Tiles(str(archive))
    sent: list[Any] = []

    async def send(message: Any) -> None:
        if not sent:  # the headers are made: another archive of the same size takes its place
            other = tmp_path / "other"
            await asyncio.to_thread(other.write_bytes, ARCHIVE[:8] + bytes(len(ARCHIVE) - 8))
            await asyncio.to_thread(other.replace, archive)
        sent.append(message)

    await asked(tiles, send)
    assert sent[0]["status"] == 200
    whole = b"".join(one.get("body", b"") for one in sent) == ARCHIVE
    assert whole  # pytest would compare them byte by byte


async def test_no_archive_is_left_open_by_whoever_goes(archive: Path) -> None:
    tiles = Tiles(str(archive))
    began = asyncio.Event()

    async def stall(message: Any) -> None:
        if message["type"] == "http.response.body":
            began.set()
            await asyncio.Event().wait()

    going = asyncio.ensure_future(asked(tiles, stall))
    async with asyncio.timeout(60):
        await began.wait()
    assert held(archive) == 1
    going.cancel()
    await asyncio.wait([going])
    assert held(archive) == 0
    before = asyncio.all_tasks()
    going = asyncio.ensure_future(asked(tiles, stall))
    for _ in range(3):  # until it is being opened
        await asyncio.sleep(0)
    going.cancel()
    await asyncio.wait([going])
    opening = asyncio.all_tasks() - before
    if opening:
        await asyncio.wait(opening, timeout=60)
    assert held(archive) == 0


def held(archive: Path) -> int:
    """Count the descriptors of this process that lead to a file."""
    links = Path("/proc/self/fd").iterdir()
    return sum(os.path.realpath(one) == str(archive) for one in links)


async def test_nothing_is_read_for_a_client_that_has_gone(archive: Path) -> None:
    await asyncio.to_thread(archive.write_bytes, ARCHIVE + bytes(16 * 2**20))
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(
            message
        )  # as listeners do after their client has gone: at once, without an error

    await asked(Tiles(str(archive)), send, gone=True)
    assert sum(len(one.get("body", b"")) for one in sent) < 8 * 2**20
    assert held(archive) == 0


async def asked(tiles: Tiles, send: Any, *, gone: bool = False) -> None:
    """Ask the page's application for the archive, past the listener; a client may be gone at once."""
    messages = [{"type": "http.request", "body": b"", "more_body": False}]
    messages += [{"type": "http.disconnect"}] if gone else []
    scope = {
        "type": "http",
        "method": "GET",
        "path": "/dashboard/map/tiles",
        "raw_path": b"/dashboard/map/tiles",
        "query_string": b"",
        "headers": [],
        "client": None,
        "server": None,
        "scheme": "http",
        "http_version": "1.1",
        "root_path": "",
        "state": {},
    }

    async def receive() -> Any:
        return messages.pop(0) if messages else await asyncio.Event().wait()

    await tiles.app(scope, receive, send)


async def test_without_an_archive_the_map_knows_that_there_is_none(http: httpx.AsyncClient) -> None:
    assert (await http.get("/dashboard/map")).json() == {"tiles": False}
    missing = await http.get("/dashboard/map/tiles")
    assert missing.status_code == 404
    assert "[plugins.dashboard] tiles" in missing.json()["error"]["remedy"]


def test_what_is_no_archive_is_refused_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        Tiles(str(tmp_path / "nothing.pmtiles"))
    other = tmp_path / "other"
    other.write_bytes(b"PMTiles\x02")
    with pytest.raises(ConfigError, match="no PMTiles archive of version 3"):
        Tiles(str(other))
