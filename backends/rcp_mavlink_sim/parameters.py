"""The parameters and their protocol: a value of any type is converted to the parameter's own.

There is no reply to an unknown name. An integer that was never stored, set to its default, is
reported as REAL32: nothing is stored, and ArduPilot forgets its type.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from rcp_mavlink_sim.parameters_table import table
from rcp_mavlink_sim.wire import mav

__all__ = ["Parameters"]

_CODES = {
    "b": mav.MAV_PARAM_TYPE_INT8,
    "h": mav.MAV_PARAM_TYPE_INT16,
    "i": mav.MAV_PARAM_TYPE_INT32,
    "f": mav.MAV_PARAM_TYPE_REAL32,
}
_BITS = {"b": 7, "h": 15, "i": 31}


class Parameters:
    """Names with types and values."""

    def __init__(self, vehicle: str, other: dict[str, float]) -> None:
        self._kinds: dict[str, str] = {}
        self._values: dict[str, float] = {}
        for name, (kind, value) in table(vehicle).items():
            self._kinds[name], self._values[name] = kind, value
        for name, value in other.items():
            self._kinds.setdefault(name, "f")
            self.set(name, value)
        self._defaults = dict(self._values)
        self._erased = False
        self._stored: set[str] = set()
        self._names = list(self._values)
        self._places = {name: place for place, name in enumerate(self._names)}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __len__(self) -> int:
        return len(self._values)

    def set(self, name: str, value: float) -> bool:
        """Set a parameter, converted to its type; return whether this succeeded."""
        kind = self._kinds.get(name)
        if kind is None or not math.isfinite(value):
            return False
        if kind == "f":
            value = struct.unpack("<f", struct.pack("<f", value))[0]
        else:
            most = 2 ** _BITS[kind] - 1
            value = float(min(most, max(-most - 1, round(value))))
        self._values[name] = value
        return True

    def erase(self) -> None:
        """Forget all that was set, from the next boot on."""
        self._erased = True

    def boot(self) -> None:
        """Read the storage."""
        if self._erased:
            self._values.update(self._defaults)
            self._stored.clear()
            self._erased = False

    def message(self, name: str, place: int | None = None, type_: int | None = None) -> Any:
        """Return the PARAM_VALUE of a name, with its index in the list."""
        at = self._places[name] if place is None else place
        reported = _CODES[self._kinds[name]] if type_ is None else type_
        return mav.MAVLink_param_value_message(
            name.encode(), self._values[name], reported, len(self._names), at
        )

    def listed(self) -> list[str]:
        """Return all names in order."""
        return self._names

    def read(self, message: Any, answer: Callable[[Any], None]) -> None:
        """Handle PARAM_REQUEST_READ, if there is such a parameter."""
        if message.param_index >= 0:
            if message.param_index < len(self._names):
                answer(self.message(self._names[message.param_index]))
            return
        name = _text(message.param_id)
        if name in self._values:
            answer(self.message(name))

    def write(self, message: Any, answer: Callable[[Any], None]) -> bool:
        """Handle PARAM_SET and reply with the value in effect; return whether it changed."""
        name = _text(message.param_id)
        if name not in self._values:
            return False
        before = self._values[name]
        if not self.set(name, message.param_value):
            return False
        if name in self._stored or not before == self._values[name] == self._defaults[name]:
            self._stored.add(name)
            answer(self.message(name, 0xFFFF))
        else:
            answer(self.message(name, 0xFFFF, mav.MAV_PARAM_TYPE_REAL32))
        return True


def _text(name: Any) -> str:
    return name if isinstance(name, str) else bytes(name).rstrip(b"\0").decode("ascii", "replace")
