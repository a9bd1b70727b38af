"""Manual control: RC_CHANNELS_OVERRIDE and MANUAL_CONTROL, until they stop arriving."""

from __future__ import annotations

from typing import Any

__all__ = ["Sticks"]

_CENTRE, _HALF = 1500, 400  # µs
_RELEASE, _RELEASE_UPPER, _IGNORE = 0, 65534, 65535
_UPPER = 8  # the first channel, from 0, that 0 does not release
_NOTHING = 0x7FFF
_CHANNELS = 16
_DEAD = 0.05


class Sticks:
    """Sixteen channels, centred without input."""

    def __init__(self) -> None:
        self.pulses = [_CENTRE] * _CHANNELS  # µs
        self._until = 0.0
        self.held = False
        """Whether there is input."""

    @property
    def roll(self) -> float:
        """Positive right, -1…1; the others likewise."""
        return self._stick(0)

    @property
    def pitch(self) -> float:
        """Negative with the stick forward (nose down), as on a real transmitter."""
        return self._stick(1)

    @property
    def throttle(self) -> float:
        """Positive up; centred neither climbs nor sinks."""
        return self._stick(2)

    @property
    def yaw(self) -> float:
        """Positive clockwise."""
        return self._stick(3)

    def _stick(self, channel: int) -> float:
        value = (self.pulses[channel] - _CENTRE) / _HALF
        return 0.0 if abs(value) < _DEAD else max(-1.0, min(1.0, value))

    def override(self, message: Any, until: float) -> None:
        """Handle RC_CHANNELS_OVERRIDE; released channels are centred again."""
        for channel in range(_CHANNELS):
            pulse = getattr(message, f"chan{channel + 1}_raw")
            if channel >= _UPPER and pulse in (_RELEASE, _RELEASE_UPPER):
                pulse = _IGNORE if pulse == _RELEASE else _RELEASE
            if pulse == _RELEASE:
                self.pulses[channel] = _CENTRE
            elif pulse != _IGNORE:
                self.pulses[channel] = pulse
                self.held, self._until = True, until

    def manual(self, message: Any, until: float, *, drives: bool) -> None:
        """Handle MANUAL_CONTROL: x is pitch, y roll, z throttle from 0, r yaw, each out of 1000.

        What drives is steered by y alone, and its throttle goes from -1000.
        """
        throttle = message.z if drives else (message.z - 500) * 2
        wanted = (message.y, -message.x, throttle, message.r)
        given = (message.y, message.x, message.z, message.r)
        if drives:
            given = (message.y, _NOTHING, message.z, _NOTHING)
        for channel, (value, raw) in enumerate(zip(wanted, given, strict=True)):
            if raw != _NOTHING:
                self.pulses[channel] = round(_CENTRE + max(-1000, min(1000, value)) * _HALF / 1000)
        self.held, self._until = True, until

    def expire(self, wall: float) -> None:
        """Release the sticks if there was no input for long."""
        if self.held and wall > self._until:
            self.held = False
            self.pulses = [_CENTRE] * _CHANNELS
