"""A position to go to, repeated while it is written: it ends, and the vehicle rests, when it is not."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, InvalidValue
from rcp_kernel.model import Resource
from rcp_mavlink import enu
from rcp_mavlink import messages as m
from rcp_mavlink.fences import beyond, is_enabled
from rcp_mavlink.hub import Hub
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.places import fix_of, native_goal, place_of
from rcp_mavlink.setpoints import Setpoints
from rcp_mavlink.vehicle import Vehicle

__all__ = ["PositionTarget", "PositionTargets"]

_ABOVE_HOME, _LOCAL_NED = 6, 1  # MAV_FRAME
_POSITION, _NO_YAW = 0b1001_1111_1000, 0b0100_0000_0000  # POSITION_TARGET_TYPEMASK
_LOCAL = "local"


class LocalPlace(Struct, frozen=True, forbid_unknown_fields=True):
    """A position in metres from the origin of the frame."""

    x: m.Metres
    """East."""
    y: m.Metres
    """North."""
    z: m.Over | None = None
    """Up; default: the present height above home, in `local` it is required of an aircraft."""


class PositionTarget(Struct, frozen=True, forbid_unknown_fields=True):
    """A position: in the map, from the estimator's origin, or by latitude and longitude."""

    position: LocalPlace | None = None
    frame: Annotated[str, Meta(pattern="^(map|local)$")] = "map"
    """Of `position`: `map` counts from home, `local` from the estimator's origin."""
    latitude: m.Latitude | None = None
    longitude: m.Longitude | None = None
    altitude: m.Over | None = None
    """Above home, m, with latitude and longitude; default: the present height."""
    yaw: m.Angle | None = None
    """Heading; default: the vehicle's own choice. Counter-clockwise from east with `position`,
    otherwise clockwise from north."""


class PositionTargets:
    """The position set-points of one vehicle."""

    def __init__(
        self, hub: Hub, vehicle: Vehicle, setpoints: Setpoints, parameters: Parameters
    ) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._setpoints, self._parameters = setpoints, parameters

    @staticmethod
    def resources(mode: str) -> list[Resource]:
        """List what it serves; the vehicle follows in `mode` only."""
        return [
            Resource(
                name="actuator/position",
                description=f"Position to go to; in {mode} only. Without a new one in time, the vehicle comes to rest.",
                value=PositionTarget,
                examples=({"position": {"x": 5.0, "y": 10.0, "z": 20.0}}, {"latitude": -35.3631, "longitude": 149.1652, "altitude": 20.0}),
                live=True, max_age=1.0, valid_for=0.5, safe={},
            )
        ]  # fmt: skip

    async def write(self, value: PositionTarget) -> None:
        """Send a position as long as it is valid; an empty one is rest.

        :raises InvalidValue: it names no place, or two.
        :raises DeviceRejected: it is outside the fence, where the vehicle would ignore it silently,
            or `local` while there is a fence, which is measured from home.
        """
        if value == PositionTarget():
            await self._setpoints.rest()
            return
        self._setpoints.check()
        message = self._local(value) if value.frame == _LOCAL else self._global(value)
        await self._setpoints.lead(lambda: message)

    def _local(self, value: PositionTarget) -> Any:
        at = value.position
        if at is None or value.latitude is not None or value.longitude is not None:
            raise InvalidValue("`local` is a frame of `position`", details={"pointer": "/frame"})
        if at.z is None and self._vehicle.family.flies:
            raise InvalidValue(
                "in the frame `local`, a height is needed",
                remedy="Give `z`, in metres above the estimator's origin.",
                details={"pointer": "/position/z"},
            )
        if is_enabled(self._vehicle):
            raise DeviceRejected(
                "position: the fence is enabled, and `local` cannot be compared with it",
                remedy="Give the position in the frame `map`, or by latitude and longitude.",
            )
        yaw = None if value.yaw is None else enu.heading(value.yaw)
        return self._hub.dialect.module.MAVLink_set_position_target_local_ned_message(
            0, self._vehicle.system, self._vehicle.component, _LOCAL_NED, _mask(yaw),
            at.y, at.x, -(at.z or 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, yaw or 0.0, 0.0,
        )  # fmt: skip

    def _global(self, value: PositionTarget) -> Any:
        vehicle, at = self._vehicle, value.position
        fix = fix_of(vehicle)
        place = None if at is None else m.Place(at.x, at.y, at.z)
        if place is None and value.latitude is None and value.longitude is None:
            raise InvalidValue(
                "no place is given", remedy="Give `position`, or `latitude` and `longitude`."
            )
        goal = native_goal(
            vehicle,
            m.MoveTo(
                position=place,
                latitude=value.latitude,
                longitude=value.longitude,
                altitude=value.altitude,
                yaw=value.yaw,
            ),
        )
        lat, lon = place_of(vehicle, goal, fix)
        height = fix.height if goal.altitude is None or vehicle.family.drives else goal.altitude
        if (why := beyond(vehicle, self._parameters, (lat, lon), height)) is not None:
            raise DeviceRejected(
                f"position: {why}",
                remedy="Choose a target inside the fence: see service/fence/download, param/FENCE_*.",
                details={"fence": why},
            )
        return self._hub.dialect.module.MAVLink_set_position_target_global_int_message(
            0, vehicle.system, vehicle.component, _ABOVE_HOME, _mask(goal.yaw),
            round(lat * 1e7), round(lon * 1e7), height,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, goal.yaw or 0.0, 0.0,
        )  # fmt: skip


def _mask(yaw: float | None) -> int:
    return _POSITION | (_NO_YAW if yaw is None else 0)
