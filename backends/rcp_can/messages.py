"""The values of a bus: frames, state, statistics, events and logs."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = [
    "BusEvent",
    "BusState",
    "Condition",
    "Count",
    "Frame",
    "Hertz",
    "Identifier",
    "Load",
    "LogFile",
    "Overflow",
    "StartLog",
    "Statistics",
]

Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]
Hertz = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "Hz"})]
Load = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "1"})]
Identifier = Annotated[int, Meta(ge=0, le=0x1FFFFFFF, extra_json_schema={"unit": "1"})]
Condition = Literal["error_active", "error_warning", "error_passive", "bus_off", "down"]
Format = Literal["candump", "asc", "blf"]


class Frame(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One frame as it is on the bus."""

    id: Identifier
    data: Annotated[bytes, Meta(max_length=64)] = b""
    extended: bool = False
    """A 29-bit identifier."""
    remote: bool = False
    fd: bool = False
    bitrate_switch: bool = False
    error: bool = False


class BusState(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """State of the controller."""

    state: Condition
    detail: str = ""
    tx_errors: Count | None = None
    """The controller's transmit error counter, if the adapter reports it."""
    rx_errors: Count | None = None


class Statistics(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Traffic on the bus; counts since the backend was opened, rates of the last period."""

    load: Load | None
    """Fraction of the time that the bus was busy; None without a bit rate."""
    rx_rate: Hertz
    tx_rate: Hertz
    rx: Count
    tx: Count
    error_frames: Count
    dropped: Count
    """Received frames that were lost because the gateway was too slow."""
    expired: Count
    """Queued frames that expired before they were sent."""
    refused: Count
    """Frames refused because the queue was full; the sender got an error."""
    failed: Count
    """Frames refused by the interface."""
    malformed: Count
    """Invalid frames from a motor or device."""
    queued: Count
    """Frames waiting to be sent."""
    restarts: Count


class BusEvent(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A change of the bus: bus-off, lost, restarted, warnings."""

    was: Condition
    now: Condition
    text: str


class Overflow(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Frames that were lost to a full queue since the last statistics."""

    queue: Literal["receive", "send"]
    lost: Count
    text: str


class StartLog(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of a new recording."""

    format: Format = "candump"


class LogFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A recording."""

    file: str
    """Its name in the bus's `log_directory`."""
    frames: Count
