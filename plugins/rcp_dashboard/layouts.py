"""The users' page layouts: one document each, which only the page interprets."""

from __future__ import annotations

import msgspec

from rcp_dashboard.config import DashboardConfig
from rcp_kernel.api import PluginStore, Principal
from rcp_kernel.errors import BadRequest, Forbidden, QueueFull, UnknownPath

__all__ = ["Layouts"]


class Layouts:
    """The layouts of all users."""

    def __init__(self, shelf: PluginStore, config: DashboardConfig) -> None:
        self._shelf = shelf
        self._config = config
        self._found: dict[str, bytes] = {
            key: value for key, value in shelf.load().items() if isinstance(value, bytes)
        }

    def get(self, principal: Principal) -> bytes:
        """Return a user's layout, as JSON.

        :raises UnknownPath: there is none.
        """
        found = self._found.get(_key(principal))
        if found is None:
            raise UnknownPath("no layout is saved for you", remedy="Save one with PUT.")
        return found

    def put(self, principal: Principal, data: bytes) -> None:
        """Store a user's layout, replacing the previous one.

        :raises Forbidden: the caller is anonymous.
        :raises BadRequest: it is not JSON.
        :raises QueueFull: the number of layouts has reached the limit.
        """
        key = _key(principal)
        try:
            msgspec.json.decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise BadRequest(f"the layout is not JSON: {error}") from None
        if key not in self._found and len(self._found) >= self._config.layouts:
            raise QueueFull(
                f"{len(self._found)} users already have a layout",
                remedy="Ask the operator to raise [plugins.dashboard] layouts.",
            )
        self._found[key] = data
        self._shelf.put(key, data)

    def delete(self, principal: Principal) -> None:
        """Delete a user's layout.

        :raises Forbidden: the caller is anonymous.
        """
        key = _key(principal)
        if self._found.pop(key, None) is not None:
            self._shelf.put(key, None)


def _key(principal: Principal) -> str:
    if principal.anonymous:
        raise Forbidden(
            "layouts are saved for authenticated users only",
            remedy="Log in with a key or token.",
        )
    return f"{principal.proof}:{principal.name}"
