"""What the router of this hub refuses: wrong certificates, and messages that its rules forbid."""

from __future__ import annotations

import asyncio
import os
import re
import threading
from collections import Counter
from collections.abc import Collection, Generator
from contextlib import contextmanager
from typing import NamedTuple

import zenoh

from rcp_fleet.stdout import reading
from rcp_kernel.errors import Forbidden, RcpError, Unauthenticated
from rcp_kernel.spi import Host

__all__ = ["Refusals"]

_PERIOD = 1.0  # s between two reports
_KINDS = 20  # refusals told apart in one report
_NAMES = 10  # robots named
_UNKNOWN = "a certificate of the unknown name"
_COLOURS = re.compile(rb"\x1b\[[0-9;]*m")
_CERTIFICATE = re.compile(
    rb'zenoh_link_(?:tls|commons)\S*: .*?((?:invalid peer|peer sent no) certificate[^"]*?)'
    rb'(?:\. Hint: .*|".*|)$'
)
_FORBIDDEN = b"Msg intercepted!"
_UNAUTHORIZED = re.compile(
    rb"interceptor::access_control: (?:Using cached result: )?(\w+)\b.* is unauthorized to "
    rb"(.+?) \(ingress\) on (\S+)$"
)
_THREAD = re.compile(rb"ThreadId\((\d+)\)")


class _Refusal(NamedTuple):
    error: type[RcpError]
    text: str
    session: str | None = None
    """Zenoh's id of whose message was forbidden, if it has said that."""


class Refusals:
    """Reports them to the gateway: a flood of them once a second, with its number."""

    def __init__(self, host: Host, session: zenoh.Session, served: Collection[str]) -> None:
        """`served` are the names of the certificates that the router serves."""
        self._host, self._session, self._served = host, session, served
        self._wanted = "RUST_LOG" in os.environ
        """Whether the operator wants to see what Zenoh writes."""
        self._lock = threading.Lock()
        self._counts = Counter[_Refusal]()
        self._why: dict[bytes, _Refusal] = {}
        """What was last forbidden, by Zenoh's thread."""
        self._rests = True
        """Whether nothing was reported for a period."""

    @contextmanager
    def reported(self) -> Generator[None]:
        """Report what is refused while entered."""
        listener = self._session.info.declare_link_events_listener(
            zenoh.handlers.Callback(self._linked, indirect=False), history=True
        )
        try:
            with reading(self._take):
                yield
        finally:
            listener.undeclare()

    def _linked(self, event: zenoh.LinkEvent) -> None:
        link = event.link
        name = link.auth_identifier
        if event.kind == zenoh.SampleKind.PUT and name is not None and name not in self._served:
            text = (
                f"{_UNKNOWN} '{name[:64]}' is used at {link.dst}: if this hub should serve it, add "
                "the name to `robots` of its backend"
            )
            self._count(_Refusal(Forbidden, text))

    def _take(self, line: bytes) -> bool:
        if b"zenoh" not in line:
            return False
        plain = _COLOURS.sub(b"", line)
        if (wrong := _CERTIFICATE.search(plain)) is not None:
            text = wrong[1].decode(errors="replace")[:300]
            self._count(_Refusal(Unauthenticated, f"a certificate was refused: {text}"))
        elif plain.endswith(_FORBIDDEN):
            self._count(self._forbidden(plain))
        elif (told := _UNAUTHORIZED.search(plain)) is not None:
            session, what, key = (part.decode(errors="replace")[:200] for part in told.groups())
            self._why[_thread(plain)] = _Refusal(Forbidden, f"{what.lower()} on {key}", session)
            return not self._wanted
        elif b" is authorized to " not in plain and b"caching permissions" not in plain:
            return False
        return not self._wanted

    def _forbidden(self, line: bytes) -> _Refusal:
        return self._why.pop(_thread(line), _Refusal(Forbidden, "messages"))

    def _count(self, refusal: _Refusal) -> None:
        with self._lock:
            if refusal not in self._counts and len(self._counts) >= _KINDS:
                refusal = _Refusal(refusal.error, "more of the kind")
            self._counts[refusal] += 1
            rests, self._rests = self._rests, False
        if rests:
            self._host.call_soon(self._report)

    def _report(self) -> None:
        with self._lock:
            counts, self._counts = self._counts, Counter()
            self._rests = not counts
        if not counts:
            return
        for refusal, count in counts.items():
            self._host.refused(refusal.error(self._told(refusal)), count=count)
        asyncio.get_running_loop().call_later(_PERIOD, self._report)

    def _told(self, refusal: _Refusal) -> str:
        if refusal.error is not Forbidden or refusal.text.startswith(_UNKNOWN):
            return refusal.text
        names = {str(link.zid): link.auth_identifier or "" for link in self._session.info.links()}
        if refusal.session is not None:
            name = names.get(refusal.session, "unknown")
            return f"the rules of the router forbid '{name}' to {refusal.text}"
        here = sorted(set(names.values()))
        shown = ", ".join(here[:_NAMES]) + (
            f" and {len(here) - _NAMES} more" if here[_NAMES:] else ""
        )
        return f"the rules of the router forbid {refusal.text} that one of {shown} sent"


def _thread(line: bytes) -> bytes:
    found = _THREAD.search(line)
    return b"" if found is None else found[1]
