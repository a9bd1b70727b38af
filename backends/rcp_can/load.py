"""The time a frame occupies the bus, for the reported load."""

from __future__ import annotations

from functools import lru_cache

__all__ = ["seconds_on_the_bus"]

_STUFFING = 1.1  # a tenth more bits for stuffing, as in typical traffic


@lru_cache(maxsize=512)
def seconds_on_the_bus(
    size: int, *, extended: bool, fd: bool, switched: bool, bitrate: int, data_bitrate: int
) -> float:
    """Return a frame's time on the bus in s, including interframe space; `size` in bytes."""
    if not fd:
        return (47 + (20 if extended else 0) + 8 * size) * _STUFFING / bitrate
    arbitration = 30 + (19 if extended else 0) + 12
    data = 8 * size + (28 if size <= 16 else 33)
    return _STUFFING * (arbitration / bitrate + data / (data_bitrate if switched else bitrate))
