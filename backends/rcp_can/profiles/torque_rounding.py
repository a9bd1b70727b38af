"""Set-points that mean what was asked for, in fields that have no code for zero.

Zero lies between the two middle codes of a velocity and of a torque. Rounded to one of them, a damper
turns a joint without friction for as long as it is told to stand still.
"""

from __future__ import annotations

from rcp_can.codec import Packed, Span

__all__ = ["TorqueRounding"]


class TorqueRounding:
    """Puts what the code of a velocity cannot express into the torque.

    What the code of that torque cannot express is made up for by the next set-point: the joint feels
    half a step of torque to and fro, and the mean is exact.
    """

    def __init__(self, *codecs: Packed) -> None:
        """`codecs` have the fields `velocity`, `kd` and `torque` of a set-point."""
        spans = {span.name: span for codec in codecs for span in codec.spans}
        self._velocity, self._kd, self._torque = spans["velocity"], spans["kd"], spans["torque"]
        self._owed = 0.0
        """What the set-points so far have left out, N·m."""

    def single(self, velocity: float, kd: float, torque: float) -> float:
        """Return the torque of a set-point that no other follows, N·m."""
        return self._torque.nearest(self._wanted(velocity, kd, torque))

    def next(self, velocity: float, kd: float, torque: float) -> float:
        """Return the torque of the next set-point, N·m."""
        wanted = self._wanted(velocity, kd, torque) + self._owed
        sent = self._torque.nearest(wanted)
        self._owed = 0.0 if _beyond(self._torque, wanted) else wanted - sent
        return sent

    def _wanted(self, velocity: float, kd: float, torque: float) -> float:
        """Return the torque with which the drive does what the values ask for.

        It applies kd * (velocity - its own) + torque, with the values that it decodes.
        """
        if _beyond(self._velocity, velocity):
            return torque
        missing = velocity - self._velocity.nearest(velocity)
        return torque + self._kd.nearest(kd) * missing


def _beyond(span: Span, value: float) -> bool:
    """Return whether a value is cut off, not rounded."""
    return span.low is None or span.high is None or not span.low <= value <= span.high
