"""Which frames of a ground station stop the vehicle, whatever it is doing."""

from __future__ import annotations

from typing import NamedTuple

from rcp_mavlink.frames import Frame

__all__ = ["Stop", "stop_of"]

_LOITER, _TERMINATE, _PAUSE, _ARM = 17, 185, 193, 400  # MAV_CMD


class Stop(NamedTuple):
    """What a stop does, and for whom: a later one says the same."""

    command: int
    system: int


def stop_of(frame: Frame) -> Stop | None:
    """Return the stop in a frame: disarm, terminate, pause or loiter; None if it is something else."""
    if frame.definition.name not in ("COMMAND_LONG", "COMMAND_INT"):
        return None
    fields = frame.fields()
    command, first = fields["command"], fields["param1"]
    stops = (
        command == _LOITER
        or (command in (_ARM, _PAUSE) and first == 0)
        or (command == _TERMINATE and first > 0)
    )
    return Stop(command, frame.system) if stops else None
