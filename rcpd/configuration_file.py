"""The configuration file on disk, the one before it, and the marker of the last proposal."""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import click
import msgspec

from rcp_kernel.features.configuration import Phase

__all__ = ["RETRY", "ConfigurationFile", "Proposal", "run_again"]

RETRY = 5.0  # s until a roll-back that failed is tried again


class Proposal(msgspec.Struct, frozen=True, kw_only=True):
    """What the marker says."""

    phase: Phase
    digest: str
    by: str
    via: str | None
    since: int
    """When, ns since the UNIX epoch."""
    seconds: float
    """For which it is on probation."""
    restart: bool
    """Whether it takes a restart to put it in force, or to roll back."""
    down: tuple[str, ...]
    """Backends that were not ready before."""
    reason: str | None = None
    recorded: bool = False
    """Whether the audit log says that it was rolled back."""


class ConfigurationFile:
    """The file of `rcpd serve`, which may be on probation."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._real = path.resolve()  # not the link to it is replaced
        self._before = self._beside("before")
        self._marker = self._beside("roll-out")
        self.proposal = self._read()
        self._late: threading.Timer | None = None
        self.served = False
        """Whether this gateway has started."""
        self.restarts = False
        """Whether the gateway is to start again after its end."""

    def _beside(self, ending: str) -> Path:
        return self._real.with_name(f"{self._real.name}.{ending}")

    def _read(self) -> Proposal | None:
        try:
            return msgspec.json.decode(self._marker.read_bytes(), type=Proposal)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError) as error:
            click.echo(f"rcpd: '{self._marker}' cannot be read and is ignored: {error}", err=True)
            return None

    @property
    def digest(self) -> str:
        """SHA-256 of the file; empty if it cannot be read."""
        try:
            return self._found()
        except OSError:
            return ""

    def _found(self) -> str:
        """Return the digest of the file, empty without one.

        :raises OSError: it cannot be read.
        """
        try:
            return _digest(self._real.read_bytes())
        except FileNotFoundError:
            return ""

    @property
    def on_probation(self) -> bool:
        """Whether the file is rolled back unless it is confirmed."""
        return self.proposal is not None and self.proposal.phase in ("probation", "restarting")

    def start(self) -> None:
        """Roll back if the gateway ended on probation, but not by the restart that put it in force."""
        if self.proposal is None or not self.on_probation:
            return
        reason = "the gateway ended before it was confirmed"
        if self.proposal.phase == "restarting" and self.digest == self.proposal.digest:
            try:
                self.enter("probation")
            except OSError as error:
                reason = f"the marker cannot be written: {error}"
            else:
                self._await_service(self.proposal.seconds)
                return
        try:
            self.roll_back(reason)
        except OSError as error:
            click.echo(f"rcpd: cannot roll back: {error}", err=True)

    def serves(self) -> None:
        """Note that the gateway has started, and looks after the time itself."""
        self.served = True
        if self._late is not None:
            self._late.cancel()

    def fails(self) -> bool:
        """Roll back if the gateway cannot start with the file on probation; return whether it did."""
        if self.served or not self.on_probation:
            return False
        try:
            return self.roll_back("the gateway cannot start with it")
        except OSError as error:
            click.echo(f"rcpd: cannot roll back: {error}", err=True)
            return False

    def restart(self, seconds: float) -> None:
        """Start the gateway again after its end, or after some time if a plugin hangs as it closes."""
        self.restarts = True
        late = threading.Timer(seconds, self._restart_late)
        late.daemon = True
        late.start()

    def _restart_late(self) -> None:
        if self.restarts:  # nobody has stopped it since
            click.echo("rcpd: restarting without waiting for a plugin", err=True)
            run_again()

    def _await_service(self, seconds: float) -> None:
        self._late = threading.Timer(seconds, self._never_served)
        self._late.daemon = True
        self._late.start()

    def _never_served(self) -> None:
        try:
            back = self.roll_back("the gateway did not start in time")
        except OSError as error:
            click.echo(f"rcpd: cannot roll back: {error}", err=True)
            self._await_service(RETRY)
            return
        if back:
            run_again()

    def begin(self, data: bytes, proposal: Proposal) -> None:
        """Put a file in force on probation, and keep the one before.

        :raises OSError: it cannot be written; the old file is in force.
        """
        old = self._real.read_bytes()
        mode = stat.S_IMODE(self._real.stat().st_mode)
        last = self.proposal
        _replace(self._before, old, mode)
        self._write(proposal)
        try:
            _replace(self._real, data, mode)
        except OSError:
            with suppress(OSError):
                self._marker.unlink() if last is None else self._write(last)
            self.proposal = last
            raise

    def enter(self, phase: Phase, reason: str | None = None) -> None:
        """Note what has become of the proposal.

        :raises OSError: it cannot be written.
        """
        if self.proposal is not None:
            self._write(msgspec.structs.replace(self.proposal, phase=phase, reason=reason))

    def roll_back(self, reason: str) -> bool:
        """Put the file before in force again, unless somebody has changed the one on probation.

        Return whether it is.

        :raises OSError: it cannot be put in force; the other one stays on probation.
        """
        if self.proposal is None:
            return False
        back = True
        if (found := self._found()) == self.proposal.digest:
            self._restore()
        else:
            back = self._before.exists() and found == _digest(self._before.read_bytes())
            reason = reason if back else "somebody changed the file at the robot"
        click.echo(f"rcpd: the configuration was rolled back: {reason}", err=True)
        fresh = msgspec.structs.replace(self.proposal, phase="rolled_back", reason=reason)
        self._write_if_possible(fresh)
        return back

    def _restore(self) -> None:
        try:
            _replace(
                self._real, self._before.read_bytes(), stat.S_IMODE(self._before.stat().st_mode)
            )
        except OSError:
            self._before.replace(self._real)  # needs no space on the disk

    def record(self) -> None:
        """Note that the audit log says what has become of the proposal."""
        if self.proposal is not None:
            self._write_if_possible(msgspec.structs.replace(self.proposal, recorded=True))

    def _write_if_possible(self, proposal: Proposal) -> None:
        """Write the marker; one that cannot be written says nothing, as the file is another."""
        try:
            self._write(proposal)
        except OSError as error:
            click.echo(f"rcpd: '{self._marker}' cannot be written: {error}", err=True)
            self.proposal = proposal

    def _write(self, proposal: Proposal) -> None:
        _replace(self._marker, msgspec.json.encode(proposal), 0o600)
        self.proposal = proposal


def run_again() -> NoReturn:
    """Start this program anew, in the same process for whoever supervises it."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606 - without a shell


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _replace(path: Path, data: bytes, mode: int) -> None:
    """Replace a file as one: after a power failure it is the old one or the new one."""
    fresh = path.with_name(f"{path.name}.new")
    with suppress(FileNotFoundError):
        fresh.unlink()
    try:
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
    except OSError:
        with suppress(OSError):
            fresh.unlink()  # part of it fills the disk
        raise
    fresh.chmod(mode)
    fresh.replace(path)
    if os.name != "nt":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
