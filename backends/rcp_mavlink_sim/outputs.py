"""Outputs that a command sets: servos that fly nothing, and relays (`AP_ServoRelayEvents`)."""

from __future__ import annotations

from collections.abc import Callable

from rcp_mavlink_sim.parameters import Parameters

__all__ = ["Outputs"]

_SERVOS, _RELAYS = 16, 5  # of which there are parameters
_FREE = frozenset({0, 1, 22, 23, 28, *range(51, 67)})
"""Functions of an output that may be commanded: none, manual, sprayer, gripper, pass-through."""
_RELAY = 1


class Outputs:
    """The outputs beside those that fly the vehicle; a reboot forgets them."""

    def __init__(self, params: Parameters, send_text: Callable[[int, str], None]) -> None:
        self._params, self._send_text = params, send_text
        self.pulses: dict[int, int] = {}
        """What was commanded, µs, by the number of the output, from 1."""
        self.relays = 0
        """Those that are on, as bits."""

    @property
    def present(self) -> int:
        """The relays that there are, as bits."""
        return sum(
            1 << n for n in range(_RELAYS) if self._params[f"RELAY{n + 1}_FUNCTION"] == _RELAY
        )

    def set_servo(self, output: float, pulse: float) -> bool:
        """Set an output, from 1; return whether this succeeded."""
        number = int(output)
        if not 1 <= number <= _SERVOS:
            return False
        if int(self._params[f"SERVO{number}_FUNCTION"]) not in _FREE:
            self._send_text(6, f"ServoRelayEvent: Channel {number} is already in use")
            return False
        self.pulses[number] = int(pulse)
        return True

    def set_relay(self, relay: float, value: float) -> bool:
        """Switch a relay, from 0; return whether this succeeded."""
        bit = 1 << int(relay) if 0 <= relay < _RELAYS else 0
        if not bit & self.present or value not in (0, 1):
            return False
        self.relays = self.relays | bit if value else self.relays & ~bit
        return True
