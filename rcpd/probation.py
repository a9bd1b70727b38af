"""Puts a proposed configuration in force, and goes back unless it is confirmed in time."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import structlog

from rcp_kernel.app.reload import needs_restart, prepare_reload, reload
from rcp_kernel.app.server import Server, prepare
from rcp_kernel.clock import SYSTEM_CLOCK, iso
from rcp_kernel.config.file import GatewayConfig, parse
from rcp_kernel.errors import (
    AdapterUnavailable,
    Failed,
    InvalidValue,
    PreconditionFailed,
    StartupError,
)
from rcp_kernel.features.configuration import FileState
from rcpd.configuration_file import ConfigurationFile, Proposal

__all__ = ["Probation"]

log = structlog.get_logger("rcp.configuration")
_REPLY = 0.2  # s for the reply to leave before sessions may end


class Probation:
    """The configuration file of a running gateway: the kernel's `ServedConfiguration`."""

    def __init__(
        self, server: Server, file: ConfigurationFile, restart: Callable[[], None]
    ) -> None:
        self._server, self._file, self._restart = server, file, restart
        self._loop = server.kernel.loop
        self._timer: asyncio.TimerHandle | None = None
        self._beginning: asyncio.TimerHandle | None = None
        self._task: asyncio.Task[None] | None = None
        file.serves()
        if file.went_back:
            self._note("went_back")
        elif file.proposal is not None and file.on_probation:
            self._arm(file.proposal.seconds)

    def close(self) -> None:
        """Stop waiting: the next start decides."""
        for timer in (self._timer, self._beginning):
            if timer is not None:
                timer.cancel()
        if self._task is not None:
            self._task.cancel()

    @property
    def state(self) -> FileState:
        """The file in force, and the last proposal."""
        last = self._file.proposal
        if last is None:
            return FileState(digest=self._file.digest)
        return FileState(
            digest=self._file.digest,
            phase=last.phase,
            proposed=last.digest,
            by=last.by,
            via=last.via,
            since=iso(last.since),
            reason=last.reason,
        )

    def check(self, text: str, *, restart: bool) -> None:
        """Check a file, without changing anything."""
        if self._file.on_probation:
            raise PreconditionFailed("another configuration is on probation", retry_after=5.0)
        fresh = self._parsed(text)
        parts = needs_restart(self._running, fresh)
        if parts and not restart:
            raise PreconditionFailed(
                f"the configuration needs a restart: it changes {', '.join(parts)}",
                remedy="Propose it with `restart`, which brings the robots to rest.",
            )
        if not parts:
            try:
                prepare_reload(self._running, fresh, str(self._file.path))
            except StartupError as error:
                raise InvalidValue(str(error)) from None

    @property
    def _running(self) -> GatewayConfig:
        return self._server.kernel.settings.config

    def _parsed(self, text: str) -> GatewayConfig:
        source = str(self._file.path)
        try:
            fresh = parse(text, source)
            prepare(fresh, source)
        except StartupError as error:
            raise InvalidValue(str(error)) from None
        return fresh

    def propose(
        self, text: str, *, by: str, via: str | None, seconds: float, restart: bool
    ) -> FileState:
        """Put a file in force, soon, and wait for its confirmation."""
        self.check(text, restart=restart)
        restart = bool(needs_restart(self._running, self._parsed(text)))
        data = text.encode()
        proposal = Proposal(
            phase="restarting" if restart else "probation",
            digest=hashlib.sha256(data).hexdigest(),
            by=by,
            via=via,
            since=SYSTEM_CLOCK.now(),
            seconds=seconds,
            restart=restart,
            down=tuple(self._unready()),
        )
        try:
            self._file.begin(data, proposal)
        except OSError as error:
            raise Failed(f"the configuration cannot be written: {error}") from None
        self._task = None
        self._arm(seconds)
        begin = self._restart if restart else partial(self._begin, self._apply)
        self._beginning = self._loop.call_later(_REPLY, begin)
        return self.state

    def _begin(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._task = self._loop.create_task(work(), name="configuration")

    async def _apply(self) -> None:
        if not await reload(self._server, self._file.path):
            await self._go_back("the gateway refused to reload it")

    def _arm(self, seconds: float) -> None:
        self._timer = self._loop.call_later(seconds, self._expire, seconds)

    def _expire(self, seconds: float) -> None:
        self._begin(partial(self._go_back, f"it was not confirmed within {seconds:g} s"))

    async def _go_back(self, reason: str) -> None:
        proposal = self._file.proposal
        if proposal is None or not self._file.on_probation:
            return
        try:
            self._file.go_back(reason)
        except OSError as error:
            log.error("configuration_cannot_go_back", reason=str(error))
            return
        self._note("went_back")
        if proposal.restart:
            self._restart()
        else:
            await reload(self._server, self._file.path)

    def confirm(self, digest: str, *, via: str | None) -> FileState:
        """Keep the file that is on probation."""
        proposal = self._file.proposal
        if proposal is None or proposal.digest != digest:
            raise PreconditionFailed("this configuration was not proposed last")
        if proposal.phase == "confirmed":
            return self.state
        if proposal.phase == "went_back" or self._file.digest != digest:
            why = proposal.reason or "it was changed at the robot"
            raise PreconditionFailed(f"the configuration is not in force: {why}")
        if proposal.via is not None and via is None:
            raise PreconditionFailed("a hub proposed this configuration, and has to confirm it")
        late = [name for name in self._unready() if name not in proposal.down]
        busy = self._task is None or not self._task.done()
        if late or (busy and not proposal.restart) or proposal.phase == "restarting":
            what = f"not ready again: {', '.join(late)}" if late else "not yet in force"
            raise AdapterUnavailable(f"the configuration is on probation, {what}", retry_after=0.5)
        try:
            self._file.enter("confirmed")
        except OSError as error:
            raise Failed(f"the marker cannot be written: {error}") from None
        self.close()
        return self.state

    def _unready(self) -> list[str]:
        return [one.name for one in self._server.supervisors if one.state != "ready"]

    def _note(self, outcome: str) -> None:
        last = self._file.proposal
        self._server.kernel.event_bus.note(
            "configuration",
            principal=None,
            path="/system/configuration",
            outcome=outcome,
            digest=self._file.digest,
            reason=None if last is None else last.reason,
        )
