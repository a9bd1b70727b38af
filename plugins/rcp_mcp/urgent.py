"""Requests that stop something: they do not queue behind other requests of the same caller."""

from __future__ import annotations

import re

import msgspec

from rcp_gateway.api import Session
from rcp_kernel.errors import RcpError
from rcp_kernel.model import parse_path
from rcp_mcp.catalogue import Catalogue, Typed
from rcp_mcp.naming import as_path
from rcp_mcp.stops import ESTOP, is_hold

__all__ = ["Urgent"]

_SHORT = 4096  # bytes, maximum size of a prioritised request; longer ones take their turn
_CANCELS = frozenset(("notifications/cancelled", "tasks/cancel"))
_HOLD = re.compile(r"service-(?:(?P<robot>[A-Za-z0-9_]+)-)?hold\Z")


class _Arguments(msgspec.Struct, frozen=True):
    path: str = ""


class _Params(msgspec.Struct, frozen=True):
    name: str = ""
    arguments: _Arguments = _Arguments()


class _Call(msgspec.Struct, frozen=True):
    method: str = ""
    params: _Params = _Params()


_CALL = msgspec.json.Decoder(_Call)


class Urgent:
    """Decides by method, tool and path only."""

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue

    def stops(self, session: Session, body: bytes) -> bool:
        """Return whether a request cancels something or brings a robot to rest."""
        if len(body) > _SHORT:
            return False
        try:
            call = _CALL.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return False
        if call.method in _CANCELS:
            return True
        if call.method != "tools/call":
            return False
        match call.params.name:
            case "cancel":
                return True
            case "execute":
                return _is_stop(_whole(session, call.params.arguments.path))
            case name:
                return self._is_stop_tool(session, name)

    def _is_stop_tool(self, session: Session, name: str) -> bool:
        """Return whether a tool stops robots; one that is not read yet is looked up by its name."""
        tools = self._catalogue.ready(session)
        if tools is not None:
            return name in tools and _is_stop(tools[name].facts["path"])
        return self._read_stop(session, name) is not None

    def tool(self, session: Session, name: str) -> Typed | None:
        """Return a tool; one that stops robots is returned without reading all others."""
        if self._catalogue.ready(session) is None and (found := self._read_stop(session, name)):
            return found
        return self._catalogue.tools(session).get(name)

    def _read_stop(self, session: Session, name: str) -> Typed | None:
        path = _path_of(name)
        return None if path is None else self._catalogue.read_one(session, path).get(name)


def _path_of(name: str) -> str | None:
    """Return the path of a tool that stops robots, as far as its name reveals it."""
    if name == "system-estop":
        return ESTOP
    match = _HOLD.match(name)
    if match is None:
        return None
    robot = match["robot"]
    return "/service/hold" if robot is None else f"/service/{robot}/hold"


def _is_stop(path: str) -> bool:
    return path == ESTOP or is_hold(path)


def _whole(session: Session, path: str) -> str:
    try:
        return parse_path(as_path(path), session.tenant)
    except RcpError:
        return ""
