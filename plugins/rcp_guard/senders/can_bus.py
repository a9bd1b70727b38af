"""Frames on a CAN bus, by python-can."""

from __future__ import annotations

import contextlib
import errno
import threading
import time
from typing import Any

from rcp_guard.senders import MissingLibraryError

__all__ = ["open_sender"]

_UNSHARED = {
    "virtual": "is inside the gateway's process",
    "serial": "cannot be opened by two processes",
    "slcan": "cannot be opened by two processes",
}
"""Interfaces on which a second process cannot send beside the gateway."""
_STREAMED = frozenset(("socketcand", "remote"))
"""Interfaces over a connection that must be read, or its server stalls."""
_DRAIN = 1.0  # s
_ROOM = 0.03  # s that all frames together may wait for room in the queue of SocketCAN
_FULL = 0.001  # s between two attempts


class CanSender:
    """Sends the frames of a plan, in order."""

    unusable = ""

    def __init__(self, bus: Any, frames: list[Any], *, drained: bool) -> None:
        self._bus = bus
        self._frames = frames
        self._closed = False
        if drained:
            threading.Thread(target=self._drain, name="can drain", daemon=True).start()

    def send(self) -> None:
        """Send all frames; a failure does not prevent the others."""
        failure: Exception | None = None
        end = time.monotonic() + _ROOM
        for frame in self._frames:
            try:
                self._send(frame, end)
            except Exception as error:
                failure = error
        if failure is not None:
            raise failure

    def _send(self, frame: Any, end: float) -> None:
        """Send a frame; SocketCAN, whose queue holds ten by default, lets no sender wait for room."""
        while True:
            try:
                self._bus.send(frame, timeout=0.01)
            except Exception as error:
                full = getattr(error, "error_code", None) == errno.ENOBUFS
                if not full or time.monotonic() > end:
                    raise
                time.sleep(_FULL)
            else:
                return

    def _drain(self) -> None:
        with contextlib.suppress(Exception):
            while not self._closed:
                self._bus.recv(_DRAIN)

    def lacks(self) -> str:
        """Return nothing: CAN receivers cannot be detected."""
        return ""

    def close(self) -> None:
        """Close the bus."""
        self._closed = True
        self._bus.shutdown()


def open_sender(data: dict[str, Any]) -> CanSender:
    """Open the bus and build the frames."""
    try:
        import can
    except ImportError as error:
        raise MissingLibraryError(f"{error}; try: pip install 'rcp-gateway[can]'") from error
    try:
        settings = dict(data["bus"])
        frames = [_frame(can, frame) for frame in data["frames"]]
    except (KeyError, TypeError, ValueError) as error:
        raise MissingLibraryError(f"invalid plan data for the sender 'can': {error!r}") from error
    interface = str(settings.get("interface"))
    if (why := _UNSHARED.get(interface)) is not None:
        raise MissingLibraryError(f"the CAN interface '{interface}' {why}")
    if interface == "socketcand":  # or Nagle delays the second frame
        settings.setdefault("tcp_tune", True)
    bus = can.Bus(**settings)
    if interface == "socketcan":  # nothing is read here: the filter matches no frame
        bus.set_filters([{"can_id": 0x1FFFFFFF, "can_mask": 0x1FFFFFFF, "extended": True}])
    return CanSender(bus, frames, drained=interface in _STREAMED)


def _frame(can: Any, frame: dict[str, Any]) -> Any:
    return can.Message(
        arbitration_id=frame["id"],
        data=bytes.fromhex(frame["data"]),
        is_extended_id=bool(frame.get("extended", False)),
        is_fd=bool(frame.get("fd", False)),
        bitrate_switch=bool(frame.get("brs", False)),
        check=True,
    )
