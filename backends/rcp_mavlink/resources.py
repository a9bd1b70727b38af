"""The resources of a vehicle: paths with types, descriptions and examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from msgspec import Meta

from rcp_kernel.model import READS, Resource
from rcp_mavlink import messages as m
from rcp_mavlink.derived import Derived
from rcp_mavlink.direct_commands import DirectCommands
from rcp_mavlink.equipment import Equipment
from rcp_mavlink.files import (
    Check,
    Entry,
    FilePath,
    FilePiece,
    FileRange,
    FileWrite,
    Remove,
    Rename,
    Written,
)
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.hub import Hub
from rcp_mavlink.imaging import Imaging
from rcp_mavlink.logs import LogPiece, LogRange, OnBoard
from rcp_mavlink.metadata import About, about
from rcp_mavlink.paramcoding import bounds
from rcp_mavlink.parameter_defaults import ParameterDefaults
from rcp_mavlink.parameter_hazards import is_hazard
from rcp_mavlink.parameter_transfer import ParameterTransfer
from rcp_mavlink.plan_transfer import PlanTransfer
from rcp_mavlink.profiles import claimed, offers
from rcp_mavlink.sensors import Sensor
from rcp_mavlink.speed_controllers import SpeedControllers
from rcp_mavlink.terrain import Terrain
from rcp_mavlink.traffic import Traffic
from rcp_mavlink.vehicle import Vehicle
from rcp_profiles import Offer

__all__ = ["parameter", "resources"]

_STALE = 3.5  # s: heartbeats come once a second
_WAYPOINTS = {
    "items": [
        {"command": "NAV_TAKEOFF", "altitude": 10.0},
        {"command": "NAV_WAYPOINT", "latitude": -35.3630, "longitude": 149.1652, "altitude": 15.0},
        {"command": "NAV_RETURN_TO_LAUNCH", "frame": "mission"},
    ]
}
_FENCE = {
    "items": [
        {
            "command": "NAV_FENCE_CIRCLE_INCLUSION",
            "params": [200.0],
            "latitude": -35.3632621,
            "longitude": 149.1652374,
        }
    ]
}
_RALLY = {
    "items": [
        {"command": "NAV_RALLY_POINT", "latitude": -35.363, "longitude": 149.165, "altitude": 20.0}
    ]
}


def resources(
    hub: Hub, vehicle: Vehicle, sensors: list[Sensor], derived: list[Derived], robot: str | None
) -> list[Resource]:
    """List the resources of a vehicle except its parameters, under the profiles that it claims."""
    found: list[Resource | Offer] = [
        Resource(
            name=sensor.name,
            description=sensor.description,
            value=hub.dialect.by_name[sensor.message].type,
            live=sensor.live,
            deadline=_STALE if sensor.live else None,
            native=sensor.message,
            meta={"message": sensor.message, "system": vehicle.system},
        )
        for sensor in sensors
    ]
    found += [
        Resource(
            name=one.name,
            description=one.description,
            value=one.type,
            live=one.live,
            deadline=_STALE if one.live else None,
            native=one.messages[0],
            meta={"message": one.messages[0], "system": vehicle.system},
        )
        for one in derived
    ]
    family = vehicle.family
    found += [*_made(), *_events(), *_actuators(hub, family), *_actions(), *_services(), *_files()]
    found += [*ParameterTransfer.resources(), *PlanTransfer.resources()]
    if not family.px4:
        found += ParameterDefaults.resources()
    found += Imaging.resources()
    found += Traffic.resources(hub.dialect) + SpeedControllers.resources(hub.dialect, family)
    found += Terrain.resources(hub.dialect, family)
    found += Equipment.resources(family, sticks=hub.config.sticks)
    if hub.config.commands:
        found += DirectCommands.resources()
    found += offers(family, hub.config.max_speed)
    return claimed(family, [one for one in found if one.name not in family.without], robot)


def parameter(path: str, name: str, type_: int, published: Mapping[str, About]) -> Resource:
    """Return the resource of a parameter of an autopilot."""
    known, limits = about(name, published), bounds(type_)
    value: Any = Annotated[float, Meta(extra_json_schema=known.schema)]
    if limits is not None:
        value = Annotated[int, Meta(ge=limits[0], le=limits[1], extra_json_schema=known.schema)]
    return Resource(
        name=path,
        description=known.text,
        value=value,
        live=True,
        energises=is_hazard(name),
        meta={"parameter": name},
    )


def _made() -> list[Resource]:
    return [
        Resource(name="sensor/mode", description="The flight mode, by the autopilot's own name.", value=str, live=True, deadline=_STALE, examples=("GUIDED",)),
        Resource(name="sensor/armed", description="Whether the vehicle is armed.", value=bool, live=True, deadline=_STALE),
        Resource(name="sensor/prearm", description="Whether it can be armed, and the reasons if not.", value=m.Prearm, live=True, examples=({"ready": False, "reasons": ["Need Position Estimate"], "mode": "GUIDED"},)),
        Resource(name="sensor/links", description="Messages received and sent over each link, damaged and lost ones.", value=list[m.LinkState], live=True),
        Resource(name="sensor/vehicle", description="System id, type and flight modes of the vehicle.", value=m.VehicleInfo, live=True),
    ]  # fmt: skip


def _events() -> list[Resource]:
    return [
        Resource(name="event/statustext", description="Status texts of the vehicle.", value=m.StatusText, live=True, examples=({"severity": "critical", "text": "PreArm: AHRS: waiting for home"},)),
        Resource(name="event/failsafe", description="A failsafe acted or the fence was breached, as reported by the vehicle.", value=m.StatusText, live=True),
        Resource(name="event/mode", description="The flight mode changed, for any reason.", value=m.ModeChange, live=True),
        Resource(name="event/armed", description="The motors were armed or disarmed.", value=m.Armed, live=True),
        Resource(name="event/mission", description="An item of the mission was reached.", value=m.Reached, live=True),
        Resource(name="event/boot", description="The vehicle has rebooted.", value=m.StatusText, live=True),
    ]  # fmt: skip


def _actuators(hub: Hub, family: Family) -> list[Resource]:
    most = hub.config.max_speed
    turning = {"x": min(1.0, most), "yaw_rate": 0.3}
    climbing = {"z": min(1.0, most), "yaw_rate": 0.3}
    return [
        Resource(
            name="actuator/velocity",
            description=f"Velocity in the body frame: x forward, y left, z up; in {family.led} only.",
            value=m.drive(most) if family.drives else m.velocity(most),
            examples=({"x": min(2.0, most)}, turning if family.drives else climbing),
            live=True, max_age=1.0, valid_for=0.5, safe={},
        ),
        Resource(
            name="actuator/attitude",
            description=f"Attitude and thrust to hold; in {family.led} only.",
            value=m.Attitude,
            examples=({"pitch": -0.1, "thrust": 0.5}, {"roll": 0.1, "thrust": 0.5}),
            live=True, max_age=1.0, valid_for=0.5, safe={},
        ),
    ]  # fmt: skip


def _action(name: str, description: str, timeout: float, **rest: Any) -> Resource:
    return Resource(
        name=f"action/{name}", description=description, timeout=timeout, max_age=30.0, **rest
    )


def _actions() -> list[Resource]:
    return [
        _action("arm", "Arm the motors, if the vehicle's own checks allow it.", 15, input=m.Arm | None, output=m.Armed, examples=(None, {}), energises=True),
        _action("disarm", "Disarm the motors; refused in the air unless forced.", 15, input=m.Arm | None, output=m.Armed, examples=(None, {})),
        _action("takeoff", "Climb to a height above home; the vehicle must be armed.", 180, input=m.TakeOff | None, output=m.Height, feedback=m.Height, examples=({"altitude": 10.0},)),
        _action("land", "Land at the current position and disarm.", 600, output=m.Height, feedback=m.OnItsWay),
        _action("rtl", "Return home: a copter lands and disarms, a plane circles there, a rover stops.", 1800, output=m.Height, feedback=m.OnItsWay),
        _action("move_to", "Go to a position, in the map or by latitude and longitude or in metres from home; a plane circles around it.", 1800, input=m.MoveTo, output=m.Arrived, feedback=m.Underway, examples=({"position": {"x": 5.0, "y": 20.0, "z": 15.0}}, {"north": 20.0, "east": 5.0, "altitude": 15.0}, {"latitude": -35.3630, "longitude": 149.1652})),
        _action("set_mode", "Change the flight mode.", 15, input=m.SetMode, output=m.SetMode, examples=({"mode": "GUIDED"},)),
        _action("mission/upload", "Replace the mission.", 300, input=m.Items, output=m.Uploaded, examples=(_WAYPOINTS,)),
        _action("mission/run", "Run the mission to its end; the vehicle must be armed.", 7200, output=m.MissionProgress, feedback=m.MissionProgress),
        _action("mission/pause", "Stop at the current position, to resume later.", 30, output=m.MissionProgress),
        _action("mission/resume", "Resume a paused mission.", 30, output=m.MissionProgress),
        _action("camera/photo", "Take a picture of what the camera points at: `action/gimbal` turns it, pitch -1.57 straight down.", 60, input=m.ByCamera | None, output=m.Photo, examples=(None, {"camera": 101})),
        _action("calibrate", "Calibrate a sensor, disarmed; the feedback tells what the vehicle waits for.", 900, input=m.Calibrate | None, output=m.Calibrated, feedback=m.Calibrating, examples=(None, {"what": "compass"})),
    ]  # fmt: skip


def _services() -> list[Resource]:
    return [
        Resource(name="service/mission/download", meta=READS, description="Return the vehicle's mission, without home.", output=m.Items, timeout=120),
        Resource(name="service/mission/set_current", moves=True, description="Set the item of the mission that is flown next; completes when the vehicle reports it.", input=m.SetItem, output=m.MissionProgress, examples=({"item": 2},), timeout=15, max_age=30.0),
        Resource(name="service/mission/clear", description="Clear the mission.", output=m.Uploaded, timeout=30),
        Resource(name="service/fence/upload", description="Replace the geofence: polygons and circles.", input=m.Items, output=m.Uploaded, examples=(_FENCE,), timeout=120),
        Resource(name="service/fence/download", meta=READS, description="Return the vehicle's geofence.", output=m.Items, timeout=120),
        Resource(name="service/rally/upload", description="Replace the rally points.", input=m.Items, output=m.Uploaded, examples=(_RALLY,), timeout=120),
        Resource(name="service/rally/download", meta=READS, description="Return the vehicle's rally points.", output=m.Items, timeout=120),
        Resource(name="service/log/list", meta=READS, description="List the on-board logs.", output=list[OnBoard], timeout=30),
        Resource(name="service/log/read", meta=READS, description="Return a part of an on-board log, at most 1 MiB.", input=LogRange, output=LogPiece, timeout=600),
        Resource(name="service/param/read", meta=READS, description="Read any parameter by name, also one without a path.", input=m.ReadParam, output=m.ParamValue, examples=({"name": "RTL_ALT"},)),
        Resource(name="service/param/save", description="Save the parameters permanently on the vehicle."),
        Resource(name="service/calibrate/continue", description="Tell a calibration with `accelerometer_full` or `radio` that what it asked for is done (ArduPilot; PX4 sees positions itself).", output=m.Calibrating),
        Resource(name="service/reboot", description="Reboot the autopilot; refused while armed.", timeout=90),
    ]  # fmt: skip


def _files() -> list[Resource]:
    return [
        Resource(name="service/ftp/list", meta=READS, description="List an on-board directory.", input=FilePath, output=list[Entry], timeout=60),
        Resource(name="service/ftp/read", meta=READS, description="Return a part of an on-board file, at most 4 MiB.", input=FileRange, output=FilePiece, timeout=1800),
        Resource(name="service/ftp/write", description="Write a part of an on-board file, at most 4 MiB; offset 0 replaces the file.", input=FileWrite, output=Written, timeout=1800),
        Resource(name="service/ftp/crc", meta=READS, description="Return the CRC-32 of a file, computed by the vehicle.", input=FilePath, output=Check, timeout=60),
        Resource(name="service/ftp/remove", description="Remove an on-board file or an empty directory.", input=Remove, timeout=30),
        Resource(name="service/ftp/mkdir", description="Create an on-board directory.", input=FilePath, timeout=30),
        Resource(name="service/ftp/rename", description="Rename an on-board file.", input=Rename, timeout=30),
    ]  # fmt: skip
