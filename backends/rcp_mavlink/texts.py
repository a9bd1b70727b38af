"""STATUSTEXT: status texts of a vehicle, with long ones reassembled."""

from __future__ import annotations

import time

from rcp_mavlink.frames import Frame
from rcp_mavlink.vehicle import Text, Vehicle

__all__ = ["SEVERITIES", "Texts"]

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_PIECE = 50
_MOST = 16  # chunks of one text


class Texts:
    """Reassembles texts and stores the latest with their vehicle."""

    id = 253

    def __init__(self) -> None:
        self._begun: dict[tuple[int, int], list[str]] = {}

    def take(self, vehicle: Vehicle, frame: Frame) -> None:
        """Add a chunk; a complete text is stored with its vehicle."""
        fields = frame.fields()
        piece = fields["text"].split(b"\0", 1)[0].decode("utf-8", "replace")
        number, full = fields.get("id", 0), len(piece) == _PIECE
        if number == 0:
            self._note(vehicle, fields["severity"], piece)
            return
        key = (vehicle.system, number)
        pieces = self._begun.setdefault(key, [])
        pieces.append(piece)
        if not full or len(pieces) >= _MOST:
            del self._begun[key]
            self._note(vehicle, fields["severity"], "".join(pieces))

    def _note(self, vehicle: Vehicle, severity: int, text: str) -> None:
        entry = Text(time.monotonic(), severity, text)
        vehicle.texts.append(entry)
        for callback in vehicle.on_text:
            callback(entry)
