"""Recordings are files that whoever may see them downloads, whole or continued."""

from __future__ import annotations

import asyncio
import io
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from plugins.recorder.gateway import ADMIN, HALF, Gateway, recording
from rcp_recorder.downloads import whole

pytestmark = pytest.mark.anyio


def _kept(files: list[dict[str, Any]]) -> Any:
    return next((file["path"] for file in files if file["state"] == "kept"), None)


async def _recorded(gateway: Gateway, secret: str | None = None) -> str:
    """Record something on request, and return the name of its file."""
    start = {"name": "drive", "paths": ["/tenant/alpha/sensor/**"]}
    await gateway.admin.request("execute", "/system/recorder", body={"start": start})
    for number in range(50):
        gateway.robot.measure("sensor/speed", float(number))
    if secret is not None:
        gateway.robot.measure("sensor/secret", secret)
    await gateway.admin.request("execute", "/system/recorder", body={"stop": "drive"})
    return await gateway.until(_kept)


async def test_a_file_is_downloaded_whole_and_in_parts(tmp_path: Path) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        name = await _recorded(gateway)
        data, url = (tmp_path / name).read_bytes(), f"recordings/{name}"
        whole = await gateway.get(url)
        etag = whole.headers["etag"]
        part = await gateway.get(url, **{"Range": "bytes=100-", "If-Range": etag})
        changed = await gateway.get(url, **{"Range": "bytes=100-", "If-Range": '"other"'})
        beyond = await gateway.get(url, Range=f"bytes={len(data)}-")
        known = await gateway.get(url, **{"If-None-Match": etag})
    assert whole.content == data
    assert f'filename="{name}"' in whole.headers["content-disposition"]
    assert (part.status_code, part.content) == (206, data[100:])
    assert part.headers["content-range"] == f"bytes 100-{len(data) - 1}/{len(data)}"
    assert (changed.status_code, changed.content) == (200, data)
    assert (beyond.status_code, known.status_code) == (416, 304)


async def test_a_file_is_hidden_from_whoever_may_not_read_all_of_it(tmp_path: Path) -> None:
    async with recording(tmp_path, paths=[]) as gateway:
        name = await _recorded(gateway, secret="hidden")
        url = f"recordings/{name}"
        refused, unknown = await gateway.get(url, HALF), await gateway.get("recordings/x.mcap")
        outside = await gateway.get("recordings/..%2F..%2Fetc%2Fpasswd")
        bag = await gateway.get(f"{url}?format=ros2")
        yaml = await gateway.get(f"{url}?format=yaml")
        odd = await gateway.get(f"{url}?format=zip")
    assert refused.status_code == unknown.status_code == 404
    assert outside.status_code in (400, 404)
    for none in (bag, yaml, odd):
        assert none.status_code == 422
        assert none.json()["error"]["remedy"]


async def test_a_file_that_is_being_written_has_to_be_complete(tmp_path: Path) -> None:
    async with recording(tmp_path) as gateway:
        gateway.robot.measure("sensor/speed", 1.0)
        await gateway.written(1)
        (name,) = await gateway.until(lambda files: [file["path"] for file in files])
        found = await gateway.get(f"recordings/{name}")
    assert found.status_code == 409
    assert "Stop the recording" in found.json()["error"]["remedy"]


async def test_rcpctl_records_lists_and_downloads(tmp_path: Path) -> None:
    folder, here = tmp_path / "recordings", tmp_path / "here"
    here.mkdir()
    async with recording(folder, paths=[]) as gateway:
        url = str(gateway.http.base_url)

        async def rcpctl(*words: str) -> str:
            process = await asyncio.create_subprocess_exec(
                str(Path(sys.executable).with_name("rcpctl")),
                "record",
                *words,
                "--url",
                url,
                "--token",
                ADMIN,
                cwd=here,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
            )
            out, _ = await process.communicate()
            assert process.returncode == 0, out.decode()
            return out.decode()

        assert "drive started: 4 paths" in await rcpctl(
            "start", "drive", "/tenant/alpha/sensor/*", "--text"
        )
        gateway.robot.measure("sensor/speed", 1.0)
        await rcpctl("stop", "drive")
        name = await gateway.until(_kept)
        assert "pinned" in await rcpctl("pin", name, "--text")
        assert name in await rcpctl("list", "drive", "--text")
        assert name in await rcpctl("download", name)
        await rcpctl("history", "/tenant/alpha/sensor/speed", "-o", "speed.csv")
    assert (here / name).read_bytes() == (folder / name).read_bytes()
    assert (here / "speed.csv").read_text().splitlines()[1].endswith(",1.0")
    assert not list(here.glob("*.part"))


class Stuck(io.BytesIO):
    """A file on a disk that does not answer, which cannot be closed while it is being read."""

    def __init__(self) -> None:
        super().__init__(b"12345")
        self.reading, self.answers, self.ended = (threading.Event() for _ in range(3))

    def read(self, size: int | None = -1) -> bytes:
        self.reading.set()
        assert self.answers.wait(60)
        return super().read(size)

    def close(self) -> None:
        assert self.answers.wait(60)
        super().close()
        self.ended.set()


async def test_a_disk_that_does_not_answer_holds_up_nobody_when_the_client_leaves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck = Stuck()
    monkeypatch.setattr(Path, "open", lambda *_: stuck)
    pieces = aiter(whole(tmp_path / "a.mcap", 5).pieces(0, None))
    reading = asyncio.ensure_future(anext(pieces))
    assert await asyncio.to_thread(stuck.reading.wait, 60)
    reading.cancel()
    with pytest.raises(asyncio.CancelledError):
        await reading  # and not the answer of the disk
    assert not stuck.ended.is_set()
    stuck.answers.set()
    assert await asyncio.to_thread(stuck.ended.wait, 60)
