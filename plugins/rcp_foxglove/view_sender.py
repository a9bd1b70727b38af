"""Advertisements: what a client knows of its view, and the messages that bring it up to date."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import msgspec

from rcp_foxglove.views import View

__all__ = ["ViewSender"]

_MOST = 262_144  # bytes of one message, about


class ViewSender:
    """The channels and services that one client knows."""

    def __init__(self, put: Callable[[bytes], None]) -> None:
        self._put = put
        self._channels: set[int] | None = None
        self._services: set[int] = set()

    def send(self, view: View) -> None:
        """Advertise what is new and unadvertise what is gone; the first time, even if it is nothing."""
        known = self._channels or set()
        channels, services = set(view.channels), set(view.services)
        self._gone("unadvertise", "channelIds", known - channels)
        self._gone("unadvertiseServices", "serviceIds", self._services - services)
        new = [one.advert for id_, one in view.channels.items() if id_ not in known]
        for data in _messages(b'{"op":"advertise","channels":[', new, empty=self._channels is None):
            self._put(data)
        new = [one.advert for id_, one in view.services.items() if id_ not in self._services]
        for data in _messages(b'{"op":"advertiseServices","services":[', new, empty=False):
            self._put(data)
        self._channels, self._services = channels, services

    def _gone(self, op: str, key: str, ids: set[int]) -> None:
        if ids:
            self._put(msgspec.json.encode({"op": op, key: sorted(ids)}))


def _messages(head: bytes, parts: Iterable[bytes], *, empty: bool) -> Iterator[bytes]:
    """Join parts to messages of a limited length."""
    held: list[bytes] = []
    size = 0
    for part in parts:
        if held and size + len(part) > _MOST:
            yield head + b",".join(held) + b"]}"
            held, size, empty = [], 0, False
        held.append(part)
        size += len(part)
    if held or empty:
        yield head + b",".join(held) + b"]}"
