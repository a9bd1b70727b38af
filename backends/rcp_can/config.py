"""The configuration of one CAN backend: its buses and the devices on them."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_can.config_device import DeviceConfig
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_can.config_dronecan import DronecanConfig, check_dronecan
from rcp_can.config_joints import JointGroupConfig
from rcp_can.config_motor import MotorConfig
from rcp_can.config_names import BusName, IdRange, Name, Seconds, id_ranges
from rcp_can.config_node import NodeConfig

__all__ = ["BusConfig", "CanConfig"]

Bitrate = Annotated[int, Meta(ge=1000, le=20_000_000, extra_json_schema={"unit": "bit/s"})]


class BusConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One bus, through a python-can interface."""

    interface: str = "socketcan"
    channel: str | int | None = "can0"
    bitrate: Bitrate | None = None
    """Passed to interfaces that set it; without it the bus load is unknown."""
    fd: bool = False
    data_bitrate: Bitrate | None = None
    """Of the data phase of CAN FD."""
    options: dict[str, Any] = {}
    """Further arguments of the interface; see the python-can documentation."""
    restart: Seconds = 0.5
    """Between bus-off or loss and the first attempt to restart; doubles up to 5 s."""
    queue: Annotated[int, Meta(ge=1, le=65_536)] = 512
    """Length of the send queue, in frames."""
    statistics: Seconds = 1.0
    """Period of `sensor/can/<bus>/statistics`."""
    frames: tuple[IdRange, ...] = ()
    """Identifiers published on `event/can/<bus>/frame`, `"0x100"` or `"0x100-0x1FF"`; all if
    empty."""
    raw_send: bool = False
    """Offer `actuator/can/<bus>/frame`, which sends any frame."""
    log_directory: str | None = None
    """Offer recording, into this directory."""
    dronecan_node: Annotated[int, Meta(ge=1, le=127)] = 126
    """The gateway's own node id, on a bus with DroneCAN nodes."""
    simulate: bool = False
    """Run a simulated drive for every motor of this bus, and a DroneCAN node for every other, on the
    `virtual` interface."""

    def __post_init__(self) -> None:
        if self.simulate and self.interface != "virtual":
            raise ValueError('`simulate` needs `interface = "virtual"`')

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """The identifiers of `frames` as closed ranges."""
        return id_ranges(self.frames)


class CanConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Buses and the devices on them."""

    buses: Annotated[dict[BusName, BusConfig], Meta(min_length=1)]
    motors: dict[Name, MotorConfig] = {}
    devices: dict[Name, DeviceConfig] = {}
    nodes: dict[Name, NodeConfig] = {}
    dronecan: dict[Name, DronecanConfig] = {}
    diff_drives: dict[Name, DiffDriveConfig] = {}
    joint_groups: dict[Name, JointGroupConfig] = {}
    grace: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] = 1.0
    """Time to wait for the motors' first messages, before the backend opens without them."""

    def __post_init__(self) -> None:
        for name, drive in self.diff_drives.items():
            for wheel in (drive.left, drive.right):
                if wheel not in self.motors:
                    raise ValueError(f"diff_drives.{name}: there is no motor {wheel!r}")
        for name, group in self.joint_groups.items():
            for joint in group.joints:
                if joint not in self.motors:
                    raise ValueError(f"joint_groups.{name}.joints: there is no motor {joint!r}")
        for table in ("diff_drives", "joint_groups"):
            robots = [name for name, group in getattr(self, table).items() if group.as_robot]
            if len(robots) > 1:
                raise ValueError(
                    f"{table}.{robots[1]}.as_robot: {robots[0]!r} is the robot already; put the "
                    "other into a backend of its own"
                )
        known = ", ".join(self.buses)
        for table in ("motors", "devices", "nodes", "dronecan"):
            for name, on in getattr(self, table).items():
                if on.bus not in self.buses:
                    raise ValueError(
                        f"{table}.{name}.bus: there is no bus {on.bus!r}, only {known}"
                    )
        check_dronecan(self.buses, self.motors, self.dronecan)
        taken: dict[tuple[str, str, int], str] = {}
        for name, motor in self.motors.items():
            if motor.profile == "dronecan":
                continue  # several controllers may be one node
            other = taken.setdefault((motor.bus, motor.profile, motor.node), name)
            if other != name:
                raise ValueError(f"motors.{name}.node: {motor.node} is already used by {other}")

    @property
    def dronecan_buses(self) -> list[str]:
        """The names of the buses with DroneCAN nodes."""
        motors = {motor.bus for motor in self.motors.values() if motor.profile == "dronecan"}
        named = motors | {node.bus for node in self.dronecan.values()}
        return [name for name in self.buses if name in named]
