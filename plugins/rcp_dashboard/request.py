"""One request to the API: its caller, and its parameters, parsed strictly."""

from __future__ import annotations

import math
from typing import TypeVar

from rcp_gateway.api import Peer, Principal, Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import BadRequest
from rcp_web.asgi import Scope, bearer, header, peer_of
from rcp_web.query import read_query, single

__all__ = ["DashboardRequest"]

_MAX_PARAMETERS = 200
_Known = TypeVar("_Known", bound=str)


class DashboardRequest:
    """The request; call `identify` first."""

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
        """Authenticate the caller, and charge the request.

        :raises Unauthenticated: the token is invalid, or required and missing.
        :raises Forbidden: the caller has no rights in the requested tenant.
        :raises RateLimited: a quota is exceeded.
        """
        token = bearer(header(self.scope, b"authorization"))
        self.principal = await client_api.identify(token, self.peer)
        self.session = client_api.session(self.principal, self.tenant, self.peer)
        client_api.charge(self.session)

    def allow(self, *names: str) -> None:
        """Refuse unknown parameters.

        :raises BadRequest: there is one.
        """
        for name in self._query:
            if name not in names and name != "tenant":
                known = ", ".join((*names, "tenant"))
                raise BadRequest(
                    f"unknown parameter {name[:60]!r}", remedy=f"The parameters are {known}."
                )

    def several(self, name: str) -> list[str]:
        """Return a repeatable parameter."""
        return self._query.get(name, [])

    def text(self, name: str) -> str | None:
        """Return a parameter that may occur once.

        :raises BadRequest: it occurs twice.
        """
        values = self._query.get(name)
        return None if values is None else single(name, values)

    def path(self, *, pattern: bool = False) -> str:
        """Return the requested resource.

        :raises BadRequest: none is given, or several.
        """
        path = self.text("path")
        if not path or ("*" in path and not pattern):
            kind = "path or pattern" if pattern else "path, without `*`"
            raise BadRequest("`path` is missing", remedy=f"Add ?path=<{kind}>.")
        return path

    def number(self, name: str, least: float, most: float) -> float | None:
        """Return a number within bounds.

        :raises BadRequest: it is not one.
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

        :raises BadRequest: it is not one.
        """
        found = self.number(name, least, most)
        if found is not None and not found.is_integer():
            raise BadRequest(f"`{name}` must be a whole number")
        return default if found is None else int(found)

    def time(self, name: str) -> float | None:
        """Return a time in s since the epoch, given as such or as ISO 8601.

        :raises BadRequest: it is neither.
        """
        text = self.text(name)
        if text is None:
            return None
        try:
            return parse_time(float(text)) / 1e9
        except ValueError:
            return parse_time(text) / 1e9

    def word(self, name: str, known: tuple[_Known, ...]) -> _Known:
        """Return one of several words; default: the first.

        :raises BadRequest: it is none of them.
        """
        text = self.text(name)
        if text is None:
            return known[0]
        for word in known:
            if word == text:
                return word
        raise BadRequest(f"`{name}` must be {' or '.join(known)}, not {text[:40]!r}")
