"""The backend: a recording's resources, and the service that controls its time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import structlog
from mcap.exceptions import McapError

from rcp_kernel.clock import iso, parse_time
from rcp_kernel.errors import ConfigError, InvalidValue, UnsupportedOperation
from rcp_kernel.model import Resource
from rcp_kernel.spi import BaseBackend, Host, MotionState, Progress, RobotFacts
from rcp_recordings.reading import Gap, Record, Recording, open_recordings
from rcp_replay.config import ReplayConfig, found
from rcp_replay.messages import ReplayRequest, ReplayState
from rcp_replay.player import Player
from rcp_replay.problems import Problems
from rcp_replay.tracks import Played, played

__all__ = ["ReplayBackend", "open_replay"]

log = structlog.get_logger("rcp.replay")
_SERVICE, _STATE = "service/replay", "sensor/replay"
_FILES = "recordings"
_PERIOD = 1.0  # s between two reports of the position
_NS = 1_000_000_000


class ReplayBackend(BaseBackend):
    """Plays a recording."""

    def __init__(self, host: Host, player: Player, files: list[Path], problems: Problems) -> None:
        self._host = host
        self._problems = problems
        self._files = tuple(file.name for file in files)
        self.player = player

    def state(self) -> ReplayState:
        """Return where it is."""
        player = self.player
        return ReplayState(
            state="ended" if player.ended else "paused" if player.paused else "playing",
            position=iso(player.position),
            elapsed=(player.position - player.start) / _NS,
            start=iso(player.start),
            end=iso(player.end),
            duration=(player.end - player.start) / _NS,
            speed=player.speed,
            loop=player.loop,
            published=player.published,
            jumps=player.jumps,
            recordings=self._files,
        )

    def report(self) -> None:
        """Publish where it is."""
        self._host.publish(_STATE, self.state())

    def jumped(self) -> None:
        """Publish where it is after its time was set."""
        self._problems.end(_FILES)
        self.report()

    def interrupted(self, gap: Gap) -> None:
        """Report that it has paused where a part cannot be read."""
        self._problems.begin(
            _FILES,
            f"the recording cannot be read from {iso(gap.start)} until {iso(gap.end)}: {gap.error}. "
            f"Play on, seek to {iso(gap.end + 1)}, or repair the file with `mcap recover`",
        )
        self.report()

    def doubted(self, gap: Gap) -> None:
        """Report that what is shown after a seek may be older than that moment."""
        self._problems.begin(
            _FILES,
            f"values of {iso(self.player.position)} may be older: the recording cannot be read from "
            f"{iso(gap.start)} until {iso(gap.end)}: {gap.error}. Play on, or repair the file with "
            "`mcap recover`",
        )

    async def read(self, name: str) -> Any:
        """Return the state; all else is only published."""
        if name == _STATE:
            return self.state()
        raise UnsupportedOperation(f"'{name}' has not been recorded before this moment")

    async def execute(self, name: str, value: ReplayRequest, progress: Progress) -> ReplayState:
        """Change what is played."""
        player = self.player
        if value.step is not None and value.paused is False:
            raise InvalidValue("a step pauses", remedy="Omit `paused`, or `step`.")
        player.change(paused=value.paused, speed=value.speed, loop=value.loop)
        if value.seek is not None:
            await player.seek(self._moment(value.seek))
        if value.step is not None:
            await player.step(value.step)
        self.report()
        return self.state()

    def _moment(self, seek: float | str) -> int:
        if isinstance(seek, str):
            return parse_time(seek)
        return self.player.start + int(seek * _NS)

    def motion(self, robot: str | None) -> MotionState:
        """Report that nothing moves: what moved then is only shown."""
        return MotionState(at_rest=True, detail="a recording")

    async def recover(self, robot: str | None) -> str:
        """Do nothing."""
        return "nothing"


@asynccontextmanager
async def open_replay(config: ReplayConfig, host: Host) -> AsyncGenerator[ReplayBackend]:
    """Open the recordings, declare what is in them, and play."""
    with ExitStack() as stack:
        files = found(config)
        try:
            recordings = await asyncio.to_thread(
                lambda: list(open_recordings([(file, None) for file in files], stack))
            )
        except McapError as error:
            raise ConfigError(f"replay: {error}. Repair it with `mcap recover`") from error
        except OSError as error:
            raise ConfigError(f"replay: a file cannot be read: {error}") from error
        tracks = _tracks(recordings)
        if not tracks:
            raise ConfigError("replay: nothing in the files was recorded by a gateway")
        problems = Problems(host.report)
        player = Player(
            recordings,
            lambda track: id(track.channel) in tracks,
            _publisher(host, tracks, problems),
            speed=config.speed,
            loop=config.loop,
            paused=config.paused,
        )
        backend = ReplayBackend(host, player, files, problems)
        host.describe(RobotFacts(kind="replay", model=", ".join(f.name for f in files)[:200]))
        declared = {one.resource.name: one.resource for one in tracks.values()}
        host.declare(*declared.values(), *_own())
        backend.report()
        player.on_jump = backend.jumped
        player.on_gap = backend.interrupted
        player.on_doubt = backend.doubted
        tasks = [
            asyncio.ensure_future(_play(player, problems)),
            asyncio.ensure_future(_tell(backend)),
        ]
        try:
            yield backend
        finally:
            for task in tasks:
                task.cancel()
            for task in tasks:
                with suppress(asyncio.CancelledError):
                    await task
            player.close()


async def _play(player: Player, problems: Problems) -> None:
    while True:
        try:
            await player.run()
        except Exception as error:  # what a damaged message, which could be read, has done here
            log.exception("replay_interrupted")
            player.change(paused=True)  # until somebody plays on
            problems.begin(_FILES, f"a message cannot be played: {error}. Play on")


def _tracks(recordings: list[Recording]) -> dict[int, Played]:
    """Return what is played, by the identity of its channel, which `recordings` keep."""
    found: dict[int, Played] = {}
    for recording in recordings:
        for track in recording.tracks.values():
            if (one := played(track)) is not None:
                found[id(track.channel)] = one
    return found


def _publisher(
    host: Host, tracks: dict[int, Played], problems: Problems
) -> Callable[[Record], None]:
    def publish(record: Record) -> None:
        one = tracks[id(record.track.channel)]
        name = one.resource.name
        try:
            value = one.value(record)
        except ValueError as error:
            problems.begin(name, f"a message of {name} cannot be decoded: {error}")
            return
        host.publish(name, value, record.publish_time)
        problems.end(name)
        problems.end(_FILES)

    return publish


def _own() -> tuple[Resource, Resource]:
    return (
        Resource(
            name=_SERVICE,
            description="Plays, pauses and seeks the recording that is replayed.",
            input=ReplayRequest,
            output=ReplayState,
            examples=({"paused": True}, {"seek": 60.0, "speed": 10.0}),
            moves=False,
            meta={"replay": "control"},
        ),
        Resource(
            name=_STATE,
            description="Where the replay of a recording is.",
            value=ReplayState,
            live=True,
            meta={"replay": "state"},
        ),
    )


async def _tell(backend: ReplayBackend) -> None:
    while True:
        await asyncio.sleep(_PERIOD)
        backend.report()
