"""One question to the API: its caller, and its parameters, read strictly."""

from __future__ import annotations

import math
from typing import TypeVar

from rcp_kernel.api import Peer, Principal, Session
from rcp_kernel.asgi import Scope, bearer, header, peer_of
from rcp_kernel.client_api import ClientApi
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import BadRequest
from rcp_web.query import read_query, single

__all__ = ["DashboardRequest"]

_MAX_PARAMETERS = 200
_Known = TypeVar("_Known", bound=str)


class DashboardRequest:
    """The request; `identify` first."""

    principal: Principal
    session: Session

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.peer: Peer = peer_of(scope)
        self._query = read_query(scope["query_string"], _MAX_PARAMETERS)
        self.tenant = self.text("tenant")
        if self.tenant is None and (named := header(scope, b"x-rcp-tenant")) is not None:
            self.tenant = named.decode("latin-1")

    async def identify(self, client_api: ClientApi) -> None:
        """Find out who asks, and count the question.

        :raises Unauthenticated: the token is not good, or there has to be one.
        :raises Forbidden: the caller does not act in the tenant that it names.
        :raises RateLimited: a quota does not allow it now.
        """
        token = bearer(header(self.scope, b"authorization"))
        self.principal = await client_api.identify(token, self.peer)
        self.session = client_api.session(self.principal, self.tenant, self.peer)
        client_api.charge(self.session)

    def allow(self, *names: str) -> None:
        """Refuse parameters that are not known here.

        :raises BadRequest: there is one.
        """
        for name in self._query:
            if name not in names and name != "tenant":
                known = ", ".join((*names, "tenant"))
                raise BadRequest(
                    f"unknown parameter {name[:60]!r}", remedy=f"The parameters are {known}."
                )

    def several(self, name: str) -> list[str]:
        """Return a parameter that may be given again and again."""
        return self._query.get(name, [])

    def text(self, name: str) -> str | None:
        """Return a parameter that may be given once.

        :raises BadRequest: it is given twice.
        """
        values = self._query.get(name)
        return None if values is None else single(name, values)

    def path(self, *, pattern: bool = False) -> str:
        """Return the resource that is meant.

        :raises BadRequest: none is named, or several.
        """
        path = self.text("path")
        if not path or ("*" in path and not pattern):
            kind = "path or pattern" if pattern else "path, without `*`"
            raise BadRequest("`path` is missing", remedy=f"Add ?path=<{kind}>.")
        return path

    def number(self, name: str, least: float, most: float) -> float | None:
        """Return a number within bounds.

        :raises BadRequest: it is none.
        """
        text = self.text(name)
        if text is None:
            return None
        try:
            found = float(text)
        except ValueError:
            found = math.nan
        if not least <= found <= most:
            raise BadRequest(
                f"`{name}` must be a number from {least:g} to {most:g}, not {text[:40]!r}"
            )
        return found

    def whole(self, name: str, least: int, most: int, default: int) -> int:
        """Return a whole number within bounds.

        :raises BadRequest: it is none.
        """
        found = self.number(name, least, most)
        if found is not None and not found.is_integer():
            raise BadRequest(f"`{name}` must be a whole number")
        return default if found is None else int(found)

    def time(self, name: str) -> float | None:
        """Return a time in s since the epoch, given so or as ISO 8601.

        :raises BadRequest: it is none.
        """
        text = self.text(name)
        if text is None:
            return None
        try:
            return parse_time(float(text)) / 1e9
        except ValueError:
            return parse_time(text) / 1e9

    def word(self, name: str, known: tuple[_Known, ...]) -> _Known:
        """Return one of some words; without the parameter the first.

        :raises BadRequest: it is another.
        """
        text = self.text(name)
        if text is None:
            return known[0]
        for word in known:
            if word == text:
                return word
        raise BadRequest(f"`{name}` must be {' or '.join(known)}, not {text[:40]!r}")
