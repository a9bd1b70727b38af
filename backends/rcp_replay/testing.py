"""A recording as a fixture: what a robot sent in the field, in a gateway without a socket.

Nothing is waited for: the test moves the recording's time. Needs pytest, as the kernel's test kit.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

from rcp_gateway.testing import ADMIN, MemoryClient, Served, serve
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import NotReady
from rcp_protocol.timeouts import timeout
from rcp_replay import rcp_backends
from rcp_replay.backend import ReplayBackend

__all__ = ["Replayed", "replayed"]

_NS = 1_000_000_000
_BOUND = 30.0  # s


class Replayed:
    """A gateway that replays, with a client that may do everything."""

    def __init__(self, served: Served, backend: ReplayBackend, client: MemoryClient) -> None:
        self.served = served
        self.backend = backend
        self.client = client

    @property
    def duration(self) -> float:
        """Length of the recording, s."""
        player = self.backend.player
        return (player.end - player.start) / _NS

    async def play_to(self, moment: float | str | None = None) -> None:
        """Publish all up to a moment: s after the beginning, ISO 8601, or None for the end."""
        player = self.backend.player
        if moment is None:
            await player.play_to(player.end)
        elif isinstance(moment, str):
            await player.play_to(parse_time(moment))
        else:
            await player.play_to(player.start + int(moment * _NS))
        self.backend.report()


@asynccontextmanager
async def replayed(
    *files: str | Path, tenant: str = "replay", more: str = ""
) -> AsyncGenerator[Replayed]:
    """Serve recordings, paused at the beginning; `more` is further configuration, in TOML."""
    listed = ", ".join(f"'{file}'" for file in files)
    config = (
        f'[[backends]]\nuse = "replay"\nname = "replay"\ntenant = "{tenant}"\n'
        f"files = [{listed}]\npaused = true\n"
        f'[[keys]]\nname = "test"\nrole = "admin"\nkey = "{ADMIN}"\n{more}\n'
    )
    async with serve(config, *rcp_backends()) as served:
        (supervisor,) = served.server.supervisors
        async with timeout(_BOUND):
            await supervisor.settled.wait()
        if not served.lives:
            raise NotReady(supervisor.last_error or "the replay has not opened")
        backend = getattr(served.life.backend, "inner", served.life.backend)
        assert isinstance(backend, ReplayBackend)
        yield Replayed(served, backend, served.client(ADMIN))
