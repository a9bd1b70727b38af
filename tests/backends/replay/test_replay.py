"""A recording is played through the tree as it was: in order, at any speed, and for looking at only."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

import hurry
from backends.replay.recorded import written
from configuration import backend, key
from hurry import Hurried
from rcp_gateway.testing import MemoryClient, eventually, serve
from rcp_recordings.reading import open_recordings
from rcp_replay import rcp_backends
from rcp_replay.config import ReplayConfig, lacking
from rcp_replay.player import Player
from rcp_replay.testing import replayed

pytestmark = pytest.mark.anyio
ADMIN = "admin-admin-admin-admin"
SPEED, CONTROL = "/tenant/then/sensor/speed", "/tenant/then/service/replay"
BOUND = 120.0  # s


@asynccontextmanager
async def playing(file: Path, **options: Any) -> AsyncGenerator[MemoryClient]:
    replay = backend("then", "then", use="replay", files=[str(file)], **options)
    config = replay + key("admin", ADMIN)
    async with serve(config, *rcp_backends()) as served:
        (supervisor,) = served.server.supervisors
        await asyncio.wait_for(supervisor.settled.wait(), BOUND)
        yield served.client(ADMIN)


async def control(client: MemoryClient, **body: Any) -> dict[str, Any]:
    reply = await client.request("execute", CONTROL, body=body)
    assert reply["status"] == "completed", reply
    return reply["body"]


class TestInHurriedTime(Hurried):
    """On a loop whose timers are not sat out at all: no other process has to keep up."""

    @pytest.fixture(autouse=True)
    def _leap(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(hurry, "_TIMES", 1e6)

    async def test_an_hour_at_ten_times_its_speed_arrives_in_order(self, tmp_path: Path) -> None:
        file = written(tmp_path, 3600, rate=2)
        async with playing(file, speed=10, paused=True) as client:
            qos = {"reliability": "reliable", "depth": 30_000}
            id_ = await client.subscribe(SPEED, qos=qos, initial=False)
            loop = asyncio.get_running_loop()
            began = loop.time()
            await control(client, paused=False)
            found = [await client.update(id_) for _ in range(7200)]
            took = loop.time() - began
        assert [update["body"] for update in found] == list(range(7200))
        assert all("dropped" not in update for update in found)
        assert 355 < took < 400  # an hour in six minutes
        times = [update["timestamp"] for update in found]
        assert times == sorted(times)
        assert times[0] == "2027-01-15T07:59:59.999999995Z"  # the recording's

    async def test_it_pauses_changes_its_speed_and_begins_again(self, tmp_path: Path) -> None:
        file = written(tmp_path, 10)
        async with playing(file, loop=True) as client:
            state = await control(client, paused=True)
            assert state["state"] == "paused"
            assert (await control(client))["position"] == state["position"]
            id_ = await client.subscribe(SPEED, qos={"reliability": "reliable"}, initial=False)
            await control(client, speed=50, paused=False)
            seen = [(await client.update(id_))["body"] for _ in range(250)]
        assert seen.count(99) >= 2  # it came to the end, and began again
        place = seen.index(99)
        assert seen[place + 1 : place + 4] == [0, 1, 2]

    async def test_without_a_loop_it_ends(self, tmp_path: Path) -> None:
        async with playing(written(tmp_path, 2), speed=10) as client:
            id_ = await client.subscribe("/tenant/then/sensor/replay")
            while (state := (await client.update(id_))["body"])["state"] != "ended":
                pass
            assert state["elapsed"] == state["duration"]
            again = await control(client, seek=0.0)
            assert again["state"] == "playing"


async def test_a_moment_shows_what_was_the_case(tmp_path: Path) -> None:
    async with playing(written(tmp_path, 100), paused=True) as client:
        state = await control(client, seek=50.05)
        assert state["elapsed"] == pytest.approx(50.05)
        speed = await client.request("read", SPEED)
        pose = await client.request("read", "/tenant/then/sensor/pose")
        assert (speed["body"], pose["body"]["position"]["x"]) == (500, 500.0)
        assert speed["source_timestamp"] == "2027-01-15T08:00:49.999999995Z"
        await control(client, seek="2027-01-15T08:00:10.05Z")
        assert (await client.request("read", SPEED))["body"] == 100
        await control(client, step=2)
        assert (await client.request("read", SPEED))["body"] == 102


async def test_what_is_replayed_says_so_and_cannot_be_commanded(tmp_path: Path) -> None:
    async with playing(written(tmp_path, 1), paused=True) as client:
        found = (await client.request("discover", "/tenant/then/**"))["body"]["resources"]
        by_path = {one["path"]: one for one in found}
        drive = by_path["/tenant/then/actuator/drive"]
        assert drive["operations"] == ["read", "subscribe"]
        assert drive["description"].startswith("Replayed: ")
        assert drive["meta"]["replayed"] is True
        assert drive["schemas"]["value"]["unit"] == "m/s"
        assert "/tenant/then/event/action/go/commands" in by_path
        assert not any("/action/" in path and "/event/" not in path for path in by_path)
        write = await client.request("write", "/tenant/then/actuator/drive", body=1.0)
        assert write["error"]["code"] == "unsupported_operation"
        (robot,) = (await client.request("read", "/system/robots"))["body"]
        assert robot["kind"] == "replay"
        stop = await client.request("execute", "/system/estop", body={})
        assert stop["status"] == "completed"
        assert (await control(client, step=1))["published"] == 1  # a stop does not blind anybody


async def test_ros_messages_are_passed_on_in_their_own_bytes(tmp_path: Path) -> None:
    async with playing(written(tmp_path, 1), paused=True) as client:
        path = "/tenant/then/sensor/header"
        id_ = await client.subscribe(path, encoding="native", initial=False)
        await control(client, step=10)
        update = await client.update(id_)
        assert update["native_type"] == "std_msgs/msg/Header"
        value = (await client.request("read", path))["body"]
    assert value == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"}


async def test_a_recording_is_a_fixture(tmp_path: Path) -> None:
    async with replayed(written(tmp_path, 60)) as replay:
        assert replay.duration == pytest.approx(59.9)
        await replay.play_to(30.0)
        path = "/tenant/replay/sensor/speed"
        assert (await replay.client.request("read", path))["body"] == 300
        await replay.play_to()
        assert (await replay.client.request("read", path))["body"] == 599
        state = (await replay.client.request("read", "/tenant/replay/sensor/replay"))["body"]
    assert state["state"] == "ended"
    assert state["recordings"] == ["drive.alpha.mcap"]


async def test_a_wrong_request_is_refused(tmp_path: Path) -> None:
    async with playing(written(tmp_path, 1), paused=True) as client:
        for body in ({"speed": 0}, {"seek": "later"}, {"step": 1, "paused": False}, {"stop": True}):
            reply = await client.request("execute", CONTROL, body=body)
            assert reply["error"]["remedy"], body


@pytest.mark.parametrize("files", [["no.mcap"], ["."]])
def test_recordings_that_are_not_there_are_told(
    files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "there is no recording" in (lacking(ReplayConfig(tuple(files))) or "")


@pytest.mark.parametrize("part", [0.0, 0.5, 0.99])
async def test_a_file_that_is_cut_off_is_not_played(tmp_path: Path, part: float) -> None:
    file = written(tmp_path, 30)
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * part)])
    replay = backend("then", "then", use="replay", files=[str(file)])
    async with serve(replay + key("admin", ADMIN), *rcp_backends()) as served:
        (supervisor,) = served.server.supervisors
        await asyncio.wait_for(supervisor.settled.wait(), BOUND)
        told = supervisor.last_error or ""
    assert "drive.alpha.mcap: the index at its end is damaged: the file is cut off" in told
    assert "`mcap recover`" in told


class TestADamagedPart:
    """The second of the three chunks of a recording: what is before and after it is played."""

    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        file = written(tmp_path, 300)
        data = bytearray(file.read_bytes())
        middle = data.index(b"\x28\xb5\x2f\xfd", len(data) // 4)
        data[middle : middle + 100] = bytes(100)
        file.write_bytes(data)
        return file

    async def test_it_pauses_there_and_a_seek_goes_beyond(self, file: Path) -> None:
        async with _damaged(file) as (client, seen):
            told = await _paused_at_the_gap(client)
            assert await _values(seen, 1000) == list(range(1000))
            assert "drive.alpha.mcap: the chunk at byte" in told
            assert (await control(client))["elapsed"] == pytest.approx(100.0)
            beyond = told.partition("seek to ")[2].partition(",")[0]
            await control(client, seek=beyond, paused=False)
            found = await _values(seen, 1001)
            assert found == [999, *range(2000, 3000)]  # the last before it, and what follows
            await _state_of_backend(client, "ready")

    async def test_playing_on_passes_over_it(self, file: Path) -> None:
        async with _damaged(file) as (client, seen):
            await _paused_at_the_gap(client)
            await _values(seen, 1000)
            await control(client, paused=False)
            assert await _values(seen, 1000) == list(range(2000, 3000))
            await _state_of_backend(client, "ready")

    async def test_a_seek_ends_the_report(self, file: Path) -> None:
        async with _damaged(file) as (client, _):
            await _paused_at_the_gap(client)
            await control(client, seek=0.0)
            await _state_of_backend(client, "ready")

    async def test_a_seek_into_it_says_that_values_are_older(self, file: Path) -> None:
        async with _damaged(file, paused=True) as (client, seen):
            await control(client, seek=150.0)
            told = await _state_of_backend(client, "degraded")
            assert "values of 2027-01-15T08:02:30" in told
            assert "the chunk at byte" in told
            assert await _values(seen, 1) == [999]
            await control(client, paused=False)

            async def is_paused() -> bool:
                return (await control(client))["state"] == "paused"

            await eventually(is_paused, "it pauses there")

    async def test_steps_end_there(self, file: Path) -> None:
        async with _damaged(file, paused=True) as (client, seen):
            await control(client, step=10_000)
            await _state_of_backend(client, "degraded")
            assert await _values(seen, 1000) == list(range(1000))
            await control(client, step=1)
            assert await _values(seen, 1) == [2000]

    async def test_a_fixture_says_so(self, file: Path) -> None:
        async with replayed(file) as replay:
            with pytest.raises(Exception, match=r"the chunk at byte \d+ is damaged"):
                await replay.play_to()
            path = "/tenant/replay/sensor/speed"
            assert (await replay.client.request("read", path))["body"] == 999


@asynccontextmanager
async def _damaged(
    file: Path, *, paused: bool = False
) -> AsyncGenerator[tuple[MemoryClient, Callable[[], Awaitable[Any]]]]:
    async with playing(file, paused=True) as client:
        qos = {"reliability": "reliable", "depth": 30_000}
        id_ = await client.subscribe(SPEED, qos=qos, initial=False)

        async def following() -> Any:
            return (await client.update(id_))["body"]

        await control(client, speed=1000.0, paused=paused)
        yield client, following


async def _values(following: Callable[[], Awaitable[Any]], count: int) -> list[Any]:
    async with asyncio.timeout(BOUND):
        return [await following() for _ in range(count)]


async def test_a_change_at_the_moment_of_its_end_does_not_keep_it(tmp_path: Path) -> None:
    published = asyncio.Event()
    with ExitStack() as stack:
        recordings = list(open_recordings([(written(tmp_path, 1), None)], stack))
        player = Player(
            recordings,
            lambda _: True,
            lambda _: published.set(),
            speed=1e-6,
            loop=False,
            paused=False,
        )
        stack.callback(player.close)
        playing = asyncio.create_task(player.run())
        await asyncio.wait_for(published.wait(), BOUND)
        for _ in range(10):  # turns of the loop, until it waits for the next record
            await asyncio.sleep(0)
        player.change(paused=True)
        playing.cancel()
        await asyncio.wait([playing], timeout=BOUND)
        assert playing.cancelled()


async def _state_of_backend(client: MemoryClient, wanted: str) -> str:
    found: dict[str, Any] = {}

    async def is_so() -> bool:
        status = await client.request("read", "/system/status")
        (found["backend"],) = status["body"]["backends"]
        return found["backend"]["state"] == wanted

    await eventually(is_so, f"the backend is {wanted}")
    return found["backend"].get("detail") or ""


async def _paused_at_the_gap(client: MemoryClient) -> str:
    told = await _state_of_backend(client, "degraded")
    assert (await control(client))["state"] == "paused"
    return told
