"""Transfers: a message or half of a service in frames of 29-bit identifiers, and back."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any, NamedTuple

from rcp_can.bus import Route
from rcp_can.dronecan.library import transport

if TYPE_CHECKING:
    import can

__all__ = ["TRANSFER_IDS", "Assembler", "Received", "Service", "encode", "message_route"]

TRANSFER_IDS = 32
"""Transfers are numbered modulo this."""
_START, _END = 0x80, 0x40  # bits of a frame's last byte; the rest is a toggle and the number
_LONGEST = 128  # frames of a transfer; the longest in use has 50
_OPEN = 64  # transfers that are received at the same time


class Service(NamedTuple):
    """What makes a transfer a request to, or a response from, one node."""

    destination: int
    request: bool


class Received(NamedTuple):
    """A whole transfer."""

    type_id: int
    source: int
    transfer_id: int
    payload: Any
    service: Service | None


def message_route(type_id: int, source: int) -> Route:
    """Return the identifiers of a node's messages of one type, in all priorities."""
    return Route(type_id << 8 | source, 0x00FFFFFF, extended=True)


def encode(
    payload: Any, *, source: int, transfer_id: int, priority: int, service: Service | None = None
) -> list[tuple[int, bytes]]:
    """Return the frames of a transfer; priority 0 is the highest, 31 the lowest."""
    transfer = transport.Transfer(
        payload=payload,
        source_node_id=source,
        transfer_id=transfer_id,
        transfer_priority=priority,
        dest_node_id=None if service is None else service.destination,
        service_not_message=service is not None,
        request_not_response=service is not None and service.request,
    )
    return [(frame.message_id, bytes(frame.bytes)) for frame in transfer.to_frames()]


class Assembler:
    """Joins frames to transfers of a few types.

    The library's own has no bound: a node that never ends a transfer would fill the memory.
    """

    def __init__(self, types: Collection[int]) -> None:
        self._types = types
        self._open: dict[int, list[Any]] = {}

    def take(self, message: can.Message) -> Received | None:
        """Take a frame; return the transfer that it completes, if it does.

        :raises ValueError: the transfer is damaged, or lacks a frame.
        """
        identifier, data = message.arbitration_id, bytes(message.data)
        is_service = bool(identifier & 0x80)
        type_id = identifier >> 16 & 0xFF if is_service else identifier >> 8 & 0xFFFF
        if type_id not in self._types:
            return None
        if not data:
            raise ValueError("a frame without its last byte")
        frame = transport.Frame(identifier, data, canfd=message.is_fd)
        if data[-1] & _START:
            frames = [frame]
        elif (frames := self._open.pop(identifier, [])) and len(frames) < _LONGEST:
            frames.append(frame)
        else:
            raise ValueError("the first frame of a transfer was lost")
        if not data[-1] & _END:
            if len(self._open) >= _OPEN:
                self._open.clear()
            self._open[identifier] = frames
            return None
        return _decode(frames)


def _decode(frames: list[Any]) -> Received:
    transfer = transport.Transfer()
    try:
        transfer.from_frames(frames)
    except Exception as error:
        raise ValueError(str(error)) from error
    service = None
    if transfer.service_not_message:
        service = Service(transfer.dest_node_id, transfer.request_not_response)
    return Received(
        transfer.data_type_id,
        transfer.source_node_id,
        transfer.transfer_id,
        transfer.payload,
        service,
    )
