"""Whether the gateway is shutting down."""

from __future__ import annotations

from rcp_kernel.errors import AdapterUnavailable

__all__ = ["Shutdown"]


class Shutdown:
    """The shutdown of the gateway: begins once, and never ends."""

    __slots__ = ("begun",)

    def __init__(self) -> None:
        self.begun = False

    def begin(self) -> None:
        """Refuse all further changes."""
        self.begun = True

    def check(self) -> None:
        """Refuse a change while the robots are brought to rest.

        :raises AdapterUnavailable: the gateway is closing.
        """
        if self.begun:
            raise AdapterUnavailable("the gateway is closing")
