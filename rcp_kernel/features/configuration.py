"""The configuration file of a gateway, which a feature may have replaced on probation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

import msgspec

from rcp_kernel.features.services import ServiceKey
from rcp_kernel.types import Time

__all__ = ["SERVED_CONFIGURATION", "FileState", "Phase", "ServedConfiguration"]

Phase = Literal["restarting", "probation", "confirmed", "rolled_back"]


class FileState(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The file and the outcome of the last proposal, without any content."""

    digest: str
    """SHA-256 of the file; empty for a gateway without one."""
    phase: Phase | None = None
    """Of the last proposal; None if there was none."""
    proposed: str | None = None
    """Digest of the last proposal, also after it was rolled back."""
    by: str | None = None
    """Who proposed it."""
    via: str | None = None
    """The hub that asserted them."""
    since: Time | None = None
    """When."""
    reason: str | None = None
    """Why it was rolled back."""


class ServedConfiguration(Protocol):
    """The file that a gateway serves; only for the event loop's thread."""

    @property
    def state(self) -> FileState:
        """The file in force, and the last proposal."""
        ...

    def check(self, text: str, *, restart: bool) -> None:
        """Check a file as `rcpd check` does; nothing is changed.

        :raises InvalidValue: it is faulty.
        :raises PreconditionFailed: it needs a `restart`, or another one is on probation.
        """
        ...

    def propose(
        self, text: str, *, by: str, via: str | None, seconds: float, restart: bool
    ) -> FileState:
        """Check a file and put it in force, soon; roll back unless it is confirmed in time.

        :raises RcpError: as `check`, or it cannot be written.
        """
        ...

    def confirm(self, digest: str, *, via: str | None) -> FileState:
        """Keep the file that is on probation.

        :raises PreconditionFailed: it is not on probation, or a hub has to confirm it.
        :raises AdapterUnavailable: a backend that was ready is not ready again.
        """
        ...


SERVED_CONFIGURATION: ServiceKey[Callable[[ServedConfiguration], None]] = ServiceKey(
    "configuration.served"
)
"""Called with the gateway's file once it runs; not called without a file."""
