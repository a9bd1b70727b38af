"""Puts a proposed configuration in force, and rolls it back unless it is confirmed in time."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import msgspec
import structlog

from rcp_gateway.reload import needs_restart, prepare_reload
from rcp_gateway.server import Prepared, Server, prepare
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
from rcpd.configuration_file import RETRY, ConfigurationFile, Proposal
from rcpd.diagnosis import Diagnosis, summary
from rcpd.hidden import Hidden
from rcpd.reload import reload
from rcpd.survey import Finding

__all__ = ["Probation"]

log = structlog.get_logger("rcp.configuration")
_REPLY = 0.2  # s for the reply to leave before sessions may end


class Probation:
    """The configuration file of a running gateway: the kernel's `ServedConfiguration`."""

    def __init__(
        self, server: Server, file: ConfigurationFile, restart: Callable[[], None]
    ) -> None:
        self._server, self._file, self._restart = server, file, restart
        self._loop = server.gateway.loop
        self._timer: asyncio.TimerHandle | None = None
        self._beginning: asyncio.TimerHandle | None = None
        self._task: asyncio.Task[None] | None = None
        self._in_force = True
        file.serves()
        last = file.proposal
        if last is not None and file.on_probation:
            self._expire_after(last.seconds)
        elif last is not None and last.phase == "rolled_back" and not last.recorded:
            self._record(last)

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
        self._needs_restart(text, restart=restart)

    def _needs_restart(self, text: str, *, restart: bool) -> bool:
        """Check a file, and return whether it needs a restart."""
        if self._file.on_probation:
            raise PreconditionFailed("another configuration is on probation", retry_after=5.0)
        source = str(self._file.path)
        try:
            fresh = parse(text, source, show_values=False)
            parts = needs_restart(self._running, fresh)
            if parts:
                prepared = prepare(fresh, source)
            else:
                prepared = prepare_reload(self._running, fresh, source)
        except StartupError as error:
            raise _refused(error, text, source) from None
        _check_plugins(prepared, text, source)
        if parts and not restart:
            raise PreconditionFailed(
                f"the configuration needs a restart: it changes {', '.join(parts)}",
                remedy="Propose it with `restart`, which brings the robots to rest.",
            )
        return bool(parts)

    @property
    def _running(self) -> GatewayConfig:
        return self._server.gateway.settings.config

    def propose(
        self, text: str, *, by: str, via: str | None, seconds: float, restart: bool
    ) -> FileState:
        """Put a file in force, soon, and wait for its confirmation."""
        restart = self._needs_restart(text, restart=restart)
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
            raise PreconditionFailed(
                f"the configuration cannot be written: {error}",
                remedy=f"Let the gateway's user write to {self._file.path.parent}, with space on "
                "the disk; a systemd unit with `ProtectSystem=strict` needs it in `ReadWritePaths`.",
            ) from None
        self._task, self._in_force = None, False
        self._expire_after(seconds)
        begin = self._restart if restart else partial(self._begin, self._apply)
        self._beginning = self._loop.call_later(_REPLY, begin)
        return self.state

    def _begin(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._task = self._loop.create_task(work(), name="configuration")

    async def _apply(self) -> None:
        self._in_force = await self._reloaded()
        if not self._in_force:
            await self._roll_back("the gateway refused to reload it")

    async def _reloaded(self) -> bool:
        try:
            return await reload(self._server, self._file.path)
        except Exception:
            log.exception("configuration_not_applied", reason="a plugin or the gateway has a bug")
            return False

    def _expire_after(self, seconds: float) -> None:
        self._roll_back_after(seconds, f"it was not confirmed within {seconds:g} s")

    def _roll_back_after(self, seconds: float, reason: str) -> None:
        self._stop_timer()
        work = partial(self._roll_back, reason)
        self._timer = self._loop.call_later(seconds, self._begin, work)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    async def _roll_back(self, reason: str) -> None:
        proposal = self._file.proposal
        if proposal is None or not self._file.on_probation:
            return
        try:
            back = self._file.roll_back(reason)
        except OSError as error:
            log.error("configuration_not_rolled_back", reason=str(error))
            self._roll_back_after(RETRY, reason)
            return
        self._stop_timer()
        self._record(self._file.proposal or proposal)
        if not back:
            return
        if proposal.restart:
            self._restart()
        else:
            await self._reloaded()

    def confirm(self, digest: str, *, via: str | None) -> FileState:
        """Keep the file that is on probation."""
        proposal = self._file.proposal
        if proposal is None or proposal.digest != digest:
            raise PreconditionFailed("this configuration was not proposed last")
        if proposal.phase == "rolled_back" or self._file.digest != digest:
            why = proposal.reason or "it was changed at the robot"
            raise PreconditionFailed(f"the configuration is not in force: {why}")
        if proposal.phase == "confirmed":
            return self.state
        if proposal.via is not None and via is None:
            raise PreconditionFailed("a hub proposed this configuration, and has to confirm it")
        if not self._in_force:
            raise _not_yet("not yet in force")
        late = [name for name in self._unready() if name not in proposal.down]
        if late:
            raise _not_yet(f"not ready again: {', '.join(late)}")
        try:
            self._file.enter("confirmed")
        except OSError as error:
            raise Failed(f"the marker cannot be written: {error}") from None
        self.close()
        return self.state

    def _unready(self) -> list[str]:
        return [one.name for one in self._server.supervisors if one.state != "ready"]

    def _record(self, proposal: Proposal) -> None:
        self._server.gateway.event_bus.note(
            "configuration",
            principal=None,
            path="/system/configuration",
            outcome="rolled_back",
            digest=self._file.digest,
            by=proposal.by,
            via=proposal.via,
            reason=proposal.reason,
        )
        self._file.record()


def _not_yet(what: str) -> AdapterUnavailable:
    return AdapterUnavailable(f"the configuration is on probation, {what}", retry_after=0.5)


def _refused(error: StartupError, text: str, source: str) -> InvalidValue:
    """Return why a file is refused: as `rcpd check` says it, without values."""
    found = Diagnosis(text, source, show_values=False)
    hidden = Hidden(text, found.secrets)

    def without_values(fault: Finding) -> Finding:
        return msgspec.structs.replace(fault, message=hidden.reason(fault.message, source))

    faults, first = [without_values(one) for one in found.findings], found.refusal(error)
    details = {"faults": msgspec.to_builtins(faults)} if faults else None
    if first is None:
        return InvalidValue(hidden.reason(str(error), source), details=details)
    message = summary(without_values(first).text(source), len(faults) - 1)
    return InvalidValue(message, details=details)


def _check_plugins(prepared: Prepared, text: str, source: str) -> None:
    for one in prepared.plugins.missing:
        hidden = Hidden(text, Diagnosis(text, source).secrets)
        why = f"{source}: {one.group} '{one.name}' cannot be imported: {one.reason}"
        raise InvalidValue(
            hidden.reason(why, source),
            remedy=f"On the robot: {one.remedy}",
        )
