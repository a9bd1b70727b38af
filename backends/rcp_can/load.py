"""The bus time of a frame, for the reported load."""

from __future__ import annotations

from functools import lru_cache

__all__ = ["seconds_on_the_bus"]

_STUFFING = 1.1  # a tenth more bits for stuffing: what usual traffic has


@lru_cache(maxsize=512)
def seconds_on_the_bus(
    size: int, *, extended: bool, fd: bool, switched: bool, bitrate: int, data_bitrate: int
) -> float:
    """Return the time of a frame with `size` data bytes, interframe space included, in s."""
    if not fd:
        return (47 + (20 if extended else 0) + 8 * size) * _STUFFING / bitrate
    arbitration = 30 + (19 if extended else 0) + 12
    data = 8 * size + (28 if size <= 16 else 33)
    return _STUFFING * (arbitration / bitrate + data / (data_bitrate if switched else bitrate))
