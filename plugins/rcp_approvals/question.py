"""One approval: the requested command, and the decision."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import Forbidden
from rcp_kernel.features.approval import Decision
from rcp_kernel.types import Time
from rcp_kernel.values import Encoding, dump, to_plain

__all__ = ["PATH", "ApprovalRequest", "ApprovalState", "Question", "digest_of", "rejected", "shown"]

PATH = "/system/approvals"
_SHOWN = 65_536  # bytes of a value that are shown; of a longer value only its length is
_Status = Literal["pending", "approved", "rejected", "used", "expired"]


class ApprovalRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A decision on an approval."""

    id: Annotated[str, Meta(max_length=64)]
    decision: Decision
    reason: Annotated[str, Meta(max_length=500)] | None = None


class ApprovalState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """An approval as clients see it."""

    approval: str
    """Its id."""
    request: Literal["write", "execute"]
    path: str
    principal: str
    """The requester."""
    status: _Status = msgspec.field(default_factory=lambda: "pending")  # always written
    asked: Time
    expires: Time
    value: Any = None
    """The value of the command."""
    steps: tuple[str, ...] = ()
    """For a plan: the steps that require approval."""
    by: str | None = None
    """Who decided."""
    reason: str | None = None


@dataclass(slots=True)
class Question:
    """An approval as the gateway stores it."""

    state: ApprovalState
    asker: Principal
    seen: tuple[str, ...]
    """Paths that must be visible to whoever decides."""
    tenants: frozenset[str]
    until: tuple[float, int]
    """When it expires, by `Clock.monotonic` and by `Clock.now`: whichever comes first.

    Wall time may be set back, and monotonic time stands still while the computer is suspended.
    """
    digest: bytes
    """Digest of this command by this principal."""
    clock: Clock
    """The gateway's."""

    @property
    def requester(self) -> tuple[str, str]:
        """Identity of the requester."""
        return self.asker.identity

    @property
    def over(self) -> bool:
        """Whether its time has passed."""
        running, wall = self.until
        return running <= self.clock.monotonic() or wall <= self.clock.now()

    @property
    def status(self) -> _Status:
        """The current status."""
        if self.state.status in ("pending", "approved") and self.over:
            self.state.status = "expired"
        return self.state.status

    @property
    def holds(self) -> bool:
        """Whether the same command can still use this approval."""
        return self.status in ("pending", "approved", "rejected") and not self.over


def digest_of(principal: Principal, type_: str, path: str, value: Any) -> bytes:
    """Return a digest that identifies one command of one principal."""
    name, proof = principal.identity
    data = msgspec.msgpack.encode([name, proof, type_, path, to_plain(value)], order="sorted")
    return hashlib.sha256(data).digest()


def shown(value: Any) -> Any:
    """Return a value as an approval shows it."""
    plain = to_plain(value)
    size = len(dump(plain, Encoding.JSON))
    return plain if size <= _SHOWN else {"omitted": size}


def rejected(state: ApprovalState) -> Forbidden:
    """Return the error for a rejected command."""
    why = f": {state.reason}" if state.reason else ""
    return Forbidden(
        f"{state.by} rejected `{state.request} {state.path}`{why}",
        path=state.path,
        remedy=f"Do not repeat the command; approval can be requested again after {state.expires}.",
        details={"approval": state.approval, "expires": state.expires},
    )
