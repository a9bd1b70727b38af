"""The producer that both servers of a comparison run: bursts of one update, or a paced beat."""

from __future__ import annotations

import json

UPDATE = {
    "position": {"x": 1.234567, "y": 4.567891, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.382683, "w": 0.923880},
    "frame_id": "map",
    "timestamp": "2026-05-29T14:12:04.123456789Z",
    "sent": 0,
    "note": "x" * 80,
}
"""About 300 B as JSON; `sent` carries the µs of its making, for latencies."""


def encoded(sent: int) -> bytes:
    return json.dumps({**UPDATE, "sent": sent}, separators=(",", ":")).encode()
