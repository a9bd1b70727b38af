"""The stick that arms an ArduPilot together with a throttle at rest: whether it was let go."""

from __future__ import annotations

import math
import time

from rcp_mavlink.frames import Frame
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ArmingSticks"]

_CHANNELS = "RC_CHANNELS"
_RATE = 10.0  # Hz
_LONG_ENOUGH = 1.0  # s
_GAP = 1.2  # s without a message after which nothing is known of the time between; some send one a second
_AWAY = 0.7  # of the way from the middle to an end; ArduPilot arms from about 0.9
_YAW, _STEERING = ("RCMAP_YAW", 4.0), ("RCMAP_ROLL", 1.0)
"""The parameters that name the channel, of what flies and of what drives, and their defaults."""
_LEAST, _MIDDLE, _MOST = 1100.0, 1500.0, 1900.0  # us, ArduPilot's defaults


class ArmingSticks:
    """The yaw or steering of one remote control, as the vehicle reckons it.

    The throttle is left out: where it rests, no vehicle arms while the yaw is near its middle.
    """

    def __init__(self, vehicle: Vehicle, intervals: Intervals, parameters: Parameters) -> None:
        self._vehicle, self._intervals, self._parameters = vehicle, intervals, parameters

    async def let_go(self, seconds: float) -> bool:
        """Wait until it has been near its middle for a second; return whether it has.

        A channel that is not reported, or parameters that are not listed yet, count as held.

        :raises AdapterUnavailable: the vehicle was lost meanwhile.
        """
        since, last = math.inf, -math.inf

        def take(frame: Frame) -> None:
            nonlocal since, last
            now = time.monotonic()
            if now - last > _GAP or not self._is_near_middle(frame):
                since = now
            last = now

        release = self._intervals.want(_CHANNELS, _RATE)
        try:
            with self._vehicle.listening(_CHANNELS, take):
                return await self._vehicle.until(lambda: last - since >= _LONG_ENOUGH, seconds)
        finally:
            release()

    def _is_near_middle(self, frame: Frame) -> bool:
        fields, family = frame.fields(), self._vehicle.family
        channel = round(self._value(*(_STEERING if family.drives else _YAW)))
        pulse = fields.get(f"chan{channel}_raw", 0)
        if not self._parameters.complete.is_set() or channel > fields["chancount"]:
            return False
        least, middle, most = (
            self._value(f"RC{channel}_{name}", usual)
            for name, usual in (("MIN", _LEAST), ("TRIM", _MIDDLE), ("MAX", _MOST))
        )
        return middle - _AWAY * (middle - least) < pulse < middle + _AWAY * (most - middle)

    def _value(self, name: str, usual: float) -> float:
        known = self._parameters.known.get(name)
        return usual if known is None else known.value
