"""One question: what somebody wants to do, and what a person has decided about it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.clock import now
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import Forbidden
from rcp_kernel.features.approval import Decision
from rcp_kernel.types import Time
from rcp_kernel.values import Encoding, dump, to_plain

__all__ = ["PATH", "ApprovalRequest", "ApprovalState", "Question", "digest_of", "rejected", "shown"]

PATH = "/system/approvals"
_SHOWN = 65_536  # bytes of a value; of a longer one its length is shown
_Status = Literal["pending", "approved", "rejected", "used", "expired"]


class ApprovalRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Decide on what somebody asked for."""

    id: Annotated[str, Meta(max_length=64)]
    decision: Decision
    reason: Annotated[str, Meta(max_length=500)] | None = None


class ApprovalState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """Something that wants a person's approval, and what became of it."""

    approval: str
    """Its id."""
    request: Literal["write", "execute"]
    path: str
    principal: str
    """Who asks."""
    status: _Status = msgspec.field(default_factory=lambda: "pending")  # always written
    asked: Time
    expires: Time
    value: Any = None
    """What would be sent."""
    steps: tuple[str, ...] = ()
    """Of a plan: the steps that want it."""
    by: str | None = None
    """Who decided."""
    reason: str | None = None


@dataclass(slots=True)
class Question:
    """A question as the gateway keeps it."""

    state: ApprovalState
    asker: tuple[str, str]
    """The identity of who asked."""
    seen: tuple[str, ...]
    """Paths that whoever decides has to see."""
    tenants: frozenset[str]
    expires: int
    digest: bytes
    """Of exactly this command of this principal."""

    @property
    def status(self) -> _Status:
        """What has become of it by now."""
        if self.state.status in ("pending", "approved") and self.expires <= now():
            self.state.status = "expired"
        return self.state.status

    @property
    def holds(self) -> bool:
        """Whether the same command need not be asked about again."""
        return self.status in ("pending", "approved", "rejected") and self.expires > now()


def digest_of(principal: Principal, type_: str, path: str, value: Any) -> bytes:
    """Tell one command of one principal from every other."""
    who, proof = principal.identity
    data = msgspec.msgpack.encode([who, proof, type_, path, to_plain(value)], order="sorted")
    return hashlib.sha256(data).digest()


def shown(value: Any) -> Any:
    """Return a value as a question shows it."""
    plain = to_plain(value)
    size = len(dump(plain, Encoding.JSON))
    return plain if size <= _SHOWN else {"omitted": size}


def rejected(state: ApprovalState) -> Forbidden:
    """Return the refusal of what a person has rejected."""
    why = f": {state.reason}" if state.reason else ""
    return Forbidden(
        f"{state.by} rejected `{state.request} {state.path}`{why}",
        path=state.path,
        remedy=f"Do not repeat the command; approval can be requested again after {state.expires}.",
        details={"approval": state.approval, "expires": state.expires},
    )
