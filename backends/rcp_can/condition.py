"""State of the controller from error frames, in SocketCAN's encoding (linux/can/error.h).

python-can always reports `bus.state` as active, so bus-off is detected here.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Condition", "read_error"]

_TX_TIMEOUT, _CONTROLLER, _PROTOCOL, _NO_ACK = 0x1, 0x4, 0x8, 0x20
_BUS_OFF, _BUS_ERROR, _RESTARTED, _COUNTERS = 0x40, 0x80, 0x100, 0x200
_WARNING, _PASSIVE, _ACTIVE, _OVERFLOW = 0x0C, 0x30, 0x40, 0x03
_PLACES = {
    _TX_TIMEOUT: "transmit time-out",
    _PROTOCOL: "protocol violation",
    _NO_ACK: "no acknowledgement",
    _BUS_ERROR: "bus error",
}


class Condition(NamedTuple):
    """Contents of one error frame; None if not reported."""

    state: str | None
    tx_errors: int | None
    rx_errors: int | None
    detail: str


def read_error(identifier: int, data: bytes) -> Condition:
    """Decode an error frame; tolerant, because adapters fill in only what they have."""
    tx = rx = None
    details = [text for bit, text in _PLACES.items() if identifier & bit]
    state = None
    if identifier & _CONTROLLER and len(data) > 1:
        if data[1] & _OVERFLOW:
            details.append("controller buffer overflow")
        state = (
            "error_passive"
            if data[1] & _PASSIVE
            else "error_warning"
            if data[1] & _WARNING
            else "error_active"
            if data[1] & _ACTIVE
            else None
        )
    if identifier & _COUNTERS and len(data) > 7:
        tx, rx = data[6], data[7]
    if identifier & _RESTARTED:
        state = "error_active"
        details.append("controller restarted")
    if identifier & _BUS_OFF:
        state = "bus_off"
        details.append("bus off")
    return Condition(state, tx, rx, ", ".join(details) or "error frame")
