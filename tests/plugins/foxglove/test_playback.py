"""Viewers play, pause and seek a replayed recording, with the messages of foxglove-sdk."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from backends.replay.recorded import SECOND, START, written
from configuration import backend, key, role, rule
from plugins.foxglove.rig import ADMIN, site
from plugins.foxglove.viewer import Viewer, viewing
from rcp_replay import rcp_backends

pytestmark = pytest.mark.anyio
LOOKER = "looker-of-these-tests"
PLAY, PAUSE = 0, 1
PLAYING, PAUSED, ENDED = 0, 1, 3
LENGTH = 60  # s of the recording
END = START + LENGTH * SECOND - SECOND // 10


class State(NamedTuple):
    """A `PlaybackState` message."""

    status: int
    moment: int
    speed: float
    seeked: bool
    id: str


def state_of(frame: bytes) -> State:
    opcode, status, moment, speed, seeked, length = struct.unpack_from("<BBQfBI", frame)
    assert opcode == 5
    assert len(frame) == 19 + length
    return State(status, moment, speed, bool(seeked), frame[19:].decode())


async def ask(
    viewer: Viewer, command: int, speed: float = 1.0, seek: int | None = None, id_: str = "a"
) -> None:
    head = struct.pack("<BBfBQI", 3, command, speed, seek is not None, seek or 0, len(id_))
    await viewer.socket.send(head + id_.encode())


async def answer(viewer: Viewer, id_: str = "a") -> State:
    """Wait for the answer to a request, and drop what came before it."""

    def found() -> State | None:
        for frame in viewer.frames:
            if frame[0] == 5 and (state := state_of(frame)).id == id_:
                return state
        return None

    state: State = await viewer.until(found)
    return state


def wall(moment: int) -> dict[str, int]:
    return {"sec": moment // SECOND, "nsec": moment % SECOND}


@asynccontextmanager
async def replaying(
    tmp_path: Path, *, loop: bool = False, twice: bool = False
) -> AsyncGenerator[str]:
    file = str(written(tmp_path, LENGTH))
    more = "".join(
        backend(name, name, use="replay", files=[file], paused=True, loop=loop)
        for name in (("then", "before") if twice else ("then",))
    )
    more += role("looker", rule("discover read subscribe", "/**"))
    more += key("looker", LOOKER, tenants=["then"])
    async with site(more=more, kinds=tuple(rcp_backends())) as made:
        for one in made.server.supervisors:
            await asyncio.wait_for(one.settled.wait(), 60)
        yield made.url


@pytest.fixture
async def url(tmp_path: Path) -> AsyncGenerator[str]:
    async with replaying(tmp_path) as made:
        yield made


@pytest.fixture
async def viewer(url: str) -> AsyncGenerator[Viewer]:
    async with viewing(f"{url}/then", ADMIN) as made:
        yield made


async def test_the_first_message_has_the_times_of_the_recording(viewer: Viewer) -> None:
    info = await viewer.op("serverInfo")
    assert {"playbackControl", "time"} <= set(info["capabilities"])
    assert (info["dataStartTime"], info["dataEndTime"]) == (wall(START), wall(END))
    state = state_of(await viewer.frame(5))
    assert state == (PAUSED, START, 1.0, False, "")


async def test_playing_messages_and_the_time_are_those_of_then(viewer: Viewer) -> None:
    await viewer.subscribe("/sensor/speed")
    await ask(viewer, PLAY, 10.0)
    assert (await answer(viewer))[0:3:2] == (PLAYING, 10.0)
    moments = [(await viewer.message())[0] for _ in range(20)]
    assert moments == sorted(moments)
    assert START - 5 <= moments[0] <= moments[-1] <= END
    times = [struct.unpack("<BQ", await viewer.frame(2))[1] for _ in range(5)]
    assert times == sorted(set(times))
    assert START < times[0] < times[-1] <= END
    await ask(viewer, PAUSE, id_="b")
    paused = await answer(viewer, "b")
    assert paused.status == PAUSED
    assert START < paused.moment < END


async def test_a_seek_is_answered_before_what_was_then(viewer: Viewer) -> None:
    await viewer.subscribe("/sensor/speed")
    moment = START + 30 * SECOND + 50_000_000
    await ask(viewer, PAUSE, 2.0, moment, "to the middle")
    assert await answer(viewer, "to the middle") == (PAUSED, moment, 2.0, True, "to the middle")
    time, payload = await viewer.message()
    assert (time, payload) == (START + 30 * SECOND - 5, b"300")
    order = [frame[0] for frame in viewer.frames if frame[0] == 5]
    assert order  # the answer is still there: the message came after it


async def test_the_end_is_told_and_play_from_the_beginning_follows(viewer: Viewer) -> None:
    await ask(viewer, PLAY, 100.0, END - SECOND // 2)
    await answer(viewer)
    ended = await viewer.until(
        lambda: [s for f in viewer.frames if f[0] == 5 and (s := state_of(f)).status == ENDED]
    )
    assert (ended[0].moment, ended[0].id) == (END, "")
    await ask(viewer, PLAY, 1.0, START, "again")
    again = await answer(viewer, "again")
    assert (again.status, again.seeked) == (PLAYING, True)
    assert START <= again.moment < END


async def test_what_another_one_does_is_told(url: str, viewer: Viewer) -> None:
    await viewer.frame(5)
    async with viewing(f"{url}/then", ADMIN) as other:
        await other.frame(5)
        await ask(other, PAUSE, 3.0, START + SECOND)
        await answer(other)
    told = await viewer.until(
        lambda: [s for f in viewer.frames if f[0] == 5 and (s := state_of(f)).seeked]
    )
    assert told[0] == (PAUSED, START + SECOND, 3.0, True, "")


async def test_a_recording_that_begins_again_says_so(tmp_path: Path) -> None:
    async with replaying(tmp_path, loop=True) as url, viewing(f"{url}/then", ADMIN) as viewer:
        await ask(viewer, PLAY, 10.0, END - SECOND)
        await answer(viewer)
        again = await viewer.until(
            lambda: [
                s for f in viewer.frames if f[0] == 5 and (s := state_of(f)).seeked and not s.id
            ]
        )
        assert again[0].status == PLAYING
        assert again[0].moment < START + 10 * SECOND


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\x03\x00", "truncated"),
        (struct.pack("<BBfBQI", 3, 7, 1.0, 0, 0, 0), "unknown command"),
        (struct.pack("<BBfBQI", 3, 0, 1.0, 0, 0, 9) + b"short", "truncated"),
        (struct.pack("<BBfBQI", 3, 0, 1.0, 0, 0, 10**6) + b"a" * 1000, "truncated"),
        (struct.pack("<BBfBQI", 3, 0, float("nan"), 0, 0, 0), "not a speed"),
        (struct.pack("<BBfBQI", 3, 0, 1.0, 0, 0, 2) + b"\xff\xfe", "truncated"),
        (struct.pack("<BBfBQI", 3, 0, -1.0, 0, 0, 1) + b"x", "not changed"),
    ],
)
async def test_a_wrong_request_is_told_and_changes_nothing(
    viewer: Viewer, data: bytes, said: str
) -> None:
    await viewer.socket.send(data)
    status: dict[str, Any] = await viewer.op("status", level=2)
    assert said in status["message"]
    await ask(viewer, PAUSE, id_="after")
    assert (await answer(viewer, "after"))[:3] == (PAUSED, START, 1.0)


async def test_a_hundred_seeks_at_once_end_at_the_last(viewer: Viewer) -> None:
    for number in range(100):
        await ask(viewer, PAUSE, 1.0, START + number * SECOND // 10, f"n{number}")
    last = await answer(viewer, "n99")
    assert last.moment == START + 99 * SECOND // 10


async def test_who_may_only_look_sees_the_time_and_no_control(url: str, viewer: Viewer) -> None:
    async with viewing(f"{url}/then", LOOKER) as looker:
        info = await looker.op("serverInfo")
        assert "time" in info["capabilities"]
        assert "playbackControl" not in info["capabilities"]
        assert "dataStartTime" not in info
        await ask(looker, PLAY)
        assert "no replay" in (await looker.op("status"))["message"]
        await ask(viewer, PLAY)
        assert START < struct.unpack("<BQ", await looker.frame(2))[1] < END


async def test_of_two_recordings_none_has_the_time(tmp_path: Path) -> None:
    async with replaying(tmp_path, twice=True) as url:
        async with viewing(url, ADMIN) as viewer:
            assert "playbackControl" not in (await viewer.op("serverInfo"))["capabilities"]
        async with viewing(f"{url}/before", ADMIN) as viewer:
            assert "playbackControl" in (await viewer.op("serverInfo"))["capabilities"]


async def test_clients_of_the_older_subprotocol_see_the_time_alone(
    url: str, viewer: Viewer
) -> None:
    async with viewing(f"{url}/then", ADMIN, "foxglove.websocket.v1") as older:
        info = await older.op("serverInfo")
        assert "playbackControl" not in info["capabilities"]
        await older.subscribe("/sensor/speed")
        await ask(viewer, PLAY, 10.0)
        await older.message()
        await older.until(lambda: sum(frame[0] == 2 for frame in older.frames) > 3)
        assert {frame[0] for frame in older.frames} <= {1, 2}  # its libraries know no other one
