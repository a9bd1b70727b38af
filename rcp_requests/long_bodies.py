"""Long bodies of writes and executes: decoded and hashed in steps before anything else is done."""

from __future__ import annotations

from collections.abc import Container, Generator
from typing import Any

import msgspec

from rcp_kernel.contract.digest import hashing
from rcp_kernel.contract.requests import PreparedRequest
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import ValueType
from rcp_kernel.wire import Request
from rcp_protocol.structure import LONG
from rcp_requests.admission import Resolver

__all__ = ["LongBodies"]

_TYPES = {"write": Operation.WRITE, "execute": Operation.EXECUTE}


class LongBodies:
    """Prepares requests; whether they are carried out is for their handlers to say."""

    def __init__(self, resolver: Resolver, actions: Container[str]) -> None:
        """Prepare no request to one of `actions`, which are checked in steps of their own."""
        self._resolver = resolver
        self._actions = actions

    def takes(self, request: Request) -> bool:
        """Return whether a request has a long body that has not been prepared yet."""
        return (
            len(request.body) > LONG
            and request.type in _TYPES
            and (request.path or "") not in self._actions
            and not isinstance(request, PreparedRequest)
        )

    def prepare(self, session: Session, request: Request) -> Generator[None, None, Request]:
        """Return the request with its body decoded, or only hashed if it is refused without that."""
        if not self.takes(request):
            return request
        type_: ValueType | None = None
        outcome: Any = None
        try:
            entry = self._resolver.resolve(session, request.path, _TYPES[request.type])
            type_, label = _body_of(request, entry)
            outcome = yield from type_.decode_in_steps(request.body, request.encoding, label)
        except RcpError as error:
            outcome = error
        yield
        recorded = yield from hashing(bytes(request.body))
        return PreparedRequest(
            **msgspec.structs.asdict(request),
            type_of_body=type_,
            outcome=outcome,
            recorded=recorded,
        )


def _body_of(request: Request, entry: Entry) -> tuple[ValueType, str]:
    """Return the type of a body, and its label in error messages."""
    if request.type == "write":
        return entry.value_type, entry.label
    return entry.input_type, f"input of {entry.label}"
