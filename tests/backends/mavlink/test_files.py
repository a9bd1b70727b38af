"""Files on board go both ways over MAVLink FTP, whole, whatever is lost on the way."""

from __future__ import annotations

import asyncio
import base64
import random
import zlib
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.mavlink.fileserver import BURST, PIECE, FileServer
from backends.mavlink.puppet import Puppet, Station, station
from rcp_gateway.testing import eventually
from rcp_mavlink.gaps import Gaps

BIG = random.Random(7).randbytes(40_000)


@asynccontextmanager
async def serving(**config: Any) -> AsyncGenerator[tuple[Station, FileServer]]:
    puppet = Puppet()
    server = FileServer(puppet.send, {"/big.bin": BIG, "/small.txt": b"hello", "/empty": b""})
    puppet.on["FILE_TRANSFER_PROTOCOL"] = server
    async with station(puppet, **config) as found:
        yield found, server


async def read(found: Station, path: str, **more: Any) -> Any:
    reply = await found.do("service/ftp/read", {"path": path, **more})
    assert reply["status"] == "completed", reply
    return base64.b64decode(reply["body"]["data"]), reply["body"]["end"]


async def test_a_directory_is_listed_past_one_message() -> None:
    async with serving() as (found, server):
        server.files |= {f"/log{n:03}.bin": bytearray(n) for n in range(60)}
        entries = (await found.do("service/ftp/list", {"path": "/"}))["body"]
        assert {"name": "logs", "kind": "directory", "size": 0} in entries
        assert {"name": "log059.bin", "kind": "file", "size": 59} in entries
        assert len(entries) == 64
        assert server.handled.count(3) > 5


@pytest.mark.parametrize("server_has", ["bursts", "no bursts", "no sizes"])
async def test_a_file_is_read_whole_and_in_parts(server_has: str) -> None:
    async with serving() as (found, server):
        server.bursts = server_has != "no bursts"
        server.sizes = server_has != "no sizes"
        assert await read(found, "/big.bin") == (BIG, True)
        assert await read(found, "/big.bin", offset=1000, count=5000) == (BIG[1000:6000], False)
        assert await read(found, "/big.bin", offset=39_990) == (BIG[39_990:], True)
        assert await read(found, "/small.txt") == (b"hello", True)
        assert await read(found, "/empty") == (b"", True)
        assert server.session is None
        if server.bursts:
            assert server.handled.count(5) < len(BIG) / PIECE / 4


async def test_what_is_lost_on_the_way_is_asked_for_again_with_progress() -> None:
    async with serving(timeout=0.1, retries=10) as (found, server):
        chance = random.Random(1)
        server.lose = lambda _: chance.random() < 0.15
        path = "/tenant/t/service/ftp/read"
        id_ = await found.client.send(type="execute", path=path, body={"path": "/big.bin"})
        parts = []
        while (reply := await found.client.reply(id_, 20.0))["status"] in (
            "accepted",
            "in_progress",
        ):
            parts.append(reply.get("progress") or 0.0)
        assert reply["status"] == "completed", reply
        assert base64.b64decode(reply["body"]["data"]) == BIG
        assert parts == sorted(parts)
        assert len(parts) > 3
        assert server.answers > len(BIG) / PIECE


async def test_late_pieces_of_a_burst_are_not_taken_for_an_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with serving(timeout=0.1, retries=10) as (found, server):
        send, late, burst = server.out, list[bytes](), 15

        def out(packed: bytes) -> None:
            if packed[5] == burst:
                late.append(packed)
                return
            while late:
                send(late.pop(0))
            send(packed)

        monkeypatch.setattr(server, "out", out)
        assert await read(found, "/big.bin") == (BIG, True)
        assert burst in server.handled


@pytest.mark.parametrize("loss", [0.0, 0.15])
async def test_a_file_is_written_and_compared(loss: float) -> None:
    async with serving(timeout=0.1, retries=10) as (found, server):
        chance = random.Random(2)
        server.lose = lambda _: chance.random() < loss
        whole = BIG[:12_000]
        first, second = whole[:5000], whole[5000:]
        for offset, data in ((0, first), (5000, second)):
            body = {"path": "/new", "data": base64.b64encode(data).decode(), "offset": offset}
            reply = await found.do("service/ftp/write", body)
            assert reply["status"] == "completed", reply
        assert bytes(server.files["/new"]) == whole
        sum_ = zlib.crc32(whole, 0xFFFFFFFF) ^ 0xFFFFFFFF
        assert reply["body"] == {"path": "/new", "size": len(whole), "crc": sum_}
        assert (await found.do("service/ftp/crc", {"path": "/new"}))["body"]["crc"] == sum_


async def test_what_is_damaged_on_board_is_not_told_as_written() -> None:
    async with serving() as (found, server):
        handle = server.answer
        server.answer = lambda op, *rest: b"\0\0\0\0" if op == 14 else handle(op, *rest)  # type: ignore[method-assign]
        body = {"path": "/new", "data": base64.b64encode(b"abc").decode()}
        reply = await found.do("service/ftp/write", body)
        assert reply["error"]["code"] == "device_rejected"


@pytest.mark.parametrize(
    ("code", "error"), [(9, "device_rejected"), (7, "not_implemented"), (10, "invalid_value")]
)
async def test_a_piece_that_is_refused_on_board_is_told_as_what_it_is(
    code: int, error: str
) -> None:
    async with serving() as (found, server):
        handle = server.answer
        server.answer = lambda op, *rest: code if op == 7 else handle(op, *rest)  # type: ignore[method-assign]
        body = {"path": "/new", "data": base64.b64encode(BIG[:3000]).decode()}
        reply = await found.do("service/ftp/write", body)
        assert reply["error"]["code"] == error, reply
        assert server.session is None


async def test_a_vehicle_that_counts_no_sums_takes_files_all_the_same() -> None:
    async with serving() as (found, server):
        server.sums = False
        body = {"path": "/new", "data": base64.b64encode(b"abc").decode()}
        reply = await found.do("service/ftp/write", body)
        assert reply["body"]["crc"] is None
        told = await found.do("service/ftp/crc", {"path": "/new"})
        assert told["error"]["code"] == "not_implemented"


async def test_files_are_renamed_and_removed_and_what_is_missing_is_told() -> None:
    async with serving() as (found, server):
        both = {"path": "/small.txt", "to": "/other.txt"}
        assert (await found.do("service/ftp/rename", both))["status"] == "completed"
        assert (await found.do("service/ftp/mkdir", {"path": "/d"}))["status"] == "completed"
        assert (await found.do("service/ftp/remove", {"path": "/other.txt"}))["status"] == (
            "completed"
        )
        assert "/other.txt" not in server.files
        for verb in ("read", "remove", "crc", "list"):
            gone = await found.do(f"service/ftp/{verb}", {"path": "/gone"})
            assert gone["error"]["code"] == "invalid_value", gone
            assert "no such file" in gone["message"]


async def test_a_session_that_somebody_left_open_is_no_hindrance() -> None:
    async with serving() as (found, server):
        server.session = ("/big.bin", "r")
        assert await read(found, "/small.txt") == (b"hello", True)


async def test_a_cancel_closes_the_file_on_board() -> None:
    async with serving() as (found, server):
        server.lose = lambda n: n > BURST
        path = "/tenant/t/service/ftp/read"
        id_ = await found.client.send(type="execute", path=path, body={"path": "/big.bin"})
        await eventually(lambda: _is(server.answers > BURST), "it reads")
        await found.client.request("cancel", path)
        assert (await found.client.final(id_))["status"] == "cancelled"
        await eventually(lambda: _is(server.session is None), "the file is closed")


async def test_a_vehicle_without_ftp_and_one_that_is_lost_end_it_with_an_error() -> None:
    async with station(Puppet()) as found:
        async with asyncio.timeout(60):
            reply = await found.do("service/ftp/list", {"path": "/"})
        assert reply["error"]["code"] == "device_timeout"
    async with serving() as (found, server):
        server.lose = lambda n: n > 5
        id_ = await found.client.send(
            type="execute", path="/tenant/t/service/ftp/read", body={"path": "/big.bin"}
        )
        await eventually(lambda: _is(server.answers > 5), "it reads")
        found.puppet.quiet = True
        final = await found.client.final(id_)
        assert final["error"]["code"] in ("adapter_unavailable", "device_timeout")


@given(data=st.data())
def test_pieces_in_any_order_make_the_whole(data: st.DataObject) -> None:
    content = data.draw(st.binary(min_size=1, max_size=200))
    start = data.draw(st.integers(0, len(content) - 1))
    gaps = Gaps(start, 1000)
    some = st.tuples(st.integers(0, 250), st.integers(1, 60))
    for at, size in data.draw(st.lists(some, max_size=30)):
        gaps.add(at, content[at : at + size])
    while (gap := gaps.first()) is not None:
        piece = content[gap[0] : min(gap[1], gap[0] + 17)]
        if piece:
            assert gaps.add(gap[0], piece) == len(piece)
        else:
            gaps.end(gap[0])
    assert gaps.data == content[start:]
    assert gaps.part == 1.0


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
