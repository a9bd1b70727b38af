"""The configuration of DroneCAN nodes, and of motors behind DroneCAN speed controllers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Protocol

import msgspec
from msgspec import Meta, Struct

from rcp_can.config_motor import MotorConfig
from rcp_can.config_names import BusName, Seconds

__all__ = ["DronecanConfig", "EscOptions", "check_dronecan"]


class EscOptions(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How one speed controller is addressed and commanded."""

    index: Annotated[int, Meta(ge=0, le=19)]
    """Its place in the commands, as set in the controller."""
    control: Literal["rpm", "raw"] = "rpm"
    """`rpm`: the controller keeps a speed; `raw`: it gets a throttle. All on a bus get the same."""
    full_speed: (
        Annotated[float, Meta(gt=0, le=13_000, extra_json_schema={"unit": "rad/s"})] | None
    ) = None
    """Speed of the shaft at full throttle; needed for `raw`."""
    reverse: bool = False
    """Whether the controller can turn the motor backwards."""
    arming: bool = True
    """Announce that the system is armed while a motor is enabled."""
    status_period: Seconds = 0.1
    """Longest usual time between two reports of its speed."""
    command_timeout: Seconds | None = None
    """Time without commands after which the controller stops the motor, as set in it."""

    def __post_init__(self) -> None:
        if self.control == "raw" and self.full_speed is None:
            raise ValueError('`control = "raw"` needs `full_speed`')
        if self.control == "rpm" and self.full_speed is not None:
            raise ValueError('`full_speed` is of `control = "raw"`')


class DronecanConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One node, and which of its messages are sensors."""

    bus: BusName
    node: Annotated[int, Meta(ge=1, le=127)]
    sensors: tuple[Literal["gnss", "battery"], ...] = ()
    battery_id: Annotated[int, Meta(ge=0, le=255)] | None = None
    """Which battery of the node; without it, every report counts."""
    parameters: bool = False
    """List the node's parameters when it appears, and offer each."""
    as_robot: bool = False
    """Its sensors are those of the backend's robot."""

    def __post_init__(self) -> None:
        if self.battery_id is not None and "battery" not in self.sensors:
            raise ValueError("`battery_id` needs the sensor `battery`")


class _Bus(Protocol):
    @property
    def dronecan_node(self) -> int: ...

    @property
    def simulate(self) -> bool: ...


def check_dronecan(
    buses: Mapping[str, _Bus],
    motors: Mapping[str, MotorConfig],
    nodes: Mapping[str, DronecanConfig],
) -> None:
    """Check what no table can know alone.

    :raises ValueError: an id or an index is used twice, or controllers of a bus differ in `control`.
    """
    _check_ids(buses, motors, nodes)
    used: dict[tuple[str, int], str] = {}
    controls: dict[str, tuple[str, str]] = {}
    simulated: dict[tuple[str, int], str] = {}
    for name, motor in motors.items():
        if motor.profile != "dronecan":
            continue
        try:
            options = msgspec.convert(motor.options, EscOptions)
        except msgspec.ValidationError as error:
            raise ValueError(f"motors.{name}.options: {error}") from error
        other = used.setdefault((motor.bus, options.index), name)
        if other != name:
            raise ValueError(
                f"motors.{name}.options.index: {options.index} is already used by {other}"
            )
        first, control = controls.setdefault(motor.bus, (name, options.control))
        if control != options.control:
            raise ValueError(
                f"motors.{name}.options.control: {first} of the same bus has {control!r}, and a "
                "command to one is a zero to the other"
            )
        one = simulated.setdefault((motor.bus, motor.node), name)
        if buses[motor.bus].simulate and one != name:
            raise ValueError(
                f"motors.{name}.node: {one} has it, and `simulate` has one controller a node"
            )


def _check_ids(
    buses: Mapping[str, _Bus],
    motors: Mapping[str, MotorConfig],
    nodes: Mapping[str, DronecanConfig],
) -> None:
    tables = [("motors", n, m) for n, m in motors.items() if m.profile == "dronecan"]
    for table, name, on in [*tables, *(("dronecan", n, node) for n, node in nodes.items())]:
        own = buses[on.bus].dronecan_node
        if on.node == own:
            raise ValueError(
                f"{table}.{name}.node: {own} is the gateway's own; "
                f"set another in buses.{on.bus}.dronecan_node"
            )
    taken: dict[tuple[str, int], str] = {}
    for name, node in nodes.items():
        other = taken.setdefault((node.bus, node.node), name)
        if other != name:
            raise ValueError(f"dronecan.{name}.node: {node.node} is already used by {other}")
    robots = [
        (name, sensor) for name, node in nodes.items() if node.as_robot for sensor in node.sensors
    ]
    owners: dict[str, str] = {}
    for name, sensor in robots:
        other = owners.setdefault(sensor, name)
        if other != name:
            raise ValueError(f"dronecan.{name}.as_robot: {other} has the robot's {sensor} already")
