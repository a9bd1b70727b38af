"""What a benchmark's clients are answered: one that is refused, or gets nothing, measures nothing."""

from __future__ import annotations

import json
import sys
from typing import Any

import msgspec

__all__ = ["Answers", "message_of"]


def message_of(data: bytes) -> dict[str, Any]:
    """Read an envelope of either encoding; what is none, as of a bare server, is empty."""
    try:
        found = json.loads(data) if data[:1] == b"{" else msgspec.msgpack.decode(data)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


class Answers:
    """Remembers the first refusal, and ends the program with it."""

    def __init__(self) -> None:
        self.refused: dict[str, Any] | None = None

    def look(self, data: bytes) -> None:
        """Note a refusal."""
        message = message_of(data)
        if self.refused is None and ("error" in message or message.get("code") == "overrun"):
            self.refused = message

    def check(self, count: int) -> None:
        """End the program if a client was refused, or nothing was counted."""
        if self.refused is not None:
            sys.exit(f"a client was refused: {json.dumps(self.refused, default=str)}")
        if not count:
            sys.exit("the clients got nothing")
