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

__all__ = ["ConfigurationFile", "Proposal", "run_again"]


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
    """Whether it takes a restart to put it in force, or to go back."""
    down: tuple[str, ...]
    """Backends that were not ready before."""
    reason: str | None = None


class ConfigurationFile:
    """The file of `rcpd serve`, which may be on probation."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._real = path.resolve()  # not the link to it is replaced
        self._before = self._beside("before")
        self._marker = self._beside("roll-out")
        self.proposal = self._read()
        self.went_back = False
        """Whether it went back before this gateway started."""
        self._late: threading.Timer | None = None
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
            return _digest(self._real.read_bytes())
        except OSError:
            return ""

    @property
    def on_probation(self) -> bool:
        """Whether the file goes back unless it is confirmed."""
        return self.proposal is not None and self.proposal.phase in ("probation", "restarting")

    def start(self) -> None:
        """Go back if the gateway ended on probation, but not by the restart that put it in force."""
        if self.proposal is None or not self.on_probation:
            return
        try:
            if self.proposal.phase == "restarting":
                self.enter("probation")
                self._late = threading.Timer(self.proposal.seconds, self._never_served)
                self._late.daemon = True
                self._late.start()
                return
            self.go_back("the gateway ended before it was confirmed")
            self.went_back = True
        except OSError as error:
            click.echo(f"rcpd: cannot go back to '{self._before}': {error}", err=True)

    def serves(self) -> None:
        """Note that the gateway has started, and looks after the time itself."""
        if self._late is not None:
            self._late.cancel()

    def _never_served(self) -> None:
        self.go_back("the gateway did not start in time")
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

    def go_back(self, reason: str) -> None:
        """Put the file before in force again, unless somebody has changed the one on probation.

        :raises OSError: it cannot be written.
        """
        if self.proposal is None:
            return
        before = self._before.read_bytes()
        if self.digest == self.proposal.digest:
            _replace(self._real, before, stat.S_IMODE(self._before.stat().st_mode))
        elif self.digest != _digest(before):
            reason = "somebody changed the file at the robot"
        self.enter("went_back", reason)
        click.echo(f"rcpd: back to the configuration before: {reason}", err=True)

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
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
        out.write(data)
        out.flush()
        os.fsync(out.fileno())
    fresh.chmod(mode)
    fresh.replace(path)
    if os.name != "nt":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
