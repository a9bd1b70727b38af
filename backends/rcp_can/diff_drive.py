"""A differential drive: two motors that take `cmd_vel` as a Twist."""

from __future__ import annotations

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_can.guard import check, check_link
from rcp_kernel.errors import InvalidValue, ModeForbids, OutOfRange
from rcp_kernel.model import Resource
from rcp_kernel.spi import check_fence
from rcp_kernel.types import Twist

__all__ = ["DiffDrivePart"]


class DiffDrivePart(Part):
    """One differential drive; its wheels also remain separate motors."""

    def __init__(self, name: str, config: DiffDriveConfig, left: Axis, right: Axis) -> None:
        self._config, self._left, self._right = config, left, right
        self._name = f"actuator/{name}/cmd_vel"

    def resources(self) -> list[Resource]:
        """List `cmd_vel`."""
        return [
            Resource(
                name=self._name,
                description="Drive: linear.x in m/s and angular.z in rad/s; the rest must be zero.",
                value=Twist,
                examples=({"linear": {"x": 0.1}}, {"angular": {"z": 0.1}}),
                max_age=1.0,
                valid_for=self._config.valid_for,
                safe={},
            )
        ]

    async def write(self, name: str, value: Twist) -> None:
        """Set both wheel velocities, or neither.

        :raises OutOfRange: a wheel would exceed its velocity limit.
        """
        check_fence()
        forward, turn = value.linear.x, value.angular.z
        if any((value.linear.y, value.linear.z, value.angular.x, value.angular.y)):
            raise InvalidValue("a differential drive has linear.x and angular.z only")
        config = self._config
        wheels = (
            (self._left, (forward - turn * config.track / 2) / config.radius),
            (self._right, (forward + turn * config.track / 2) / config.radius),
        )
        for axis, speed in wheels:
            self._check(axis, speed, still=not forward and not turn)
        for axis, speed in wheels:
            if axis.status.enabled and (speed or not axis.stopped):
                axis.command("velocity", speed)

    def _check(self, axis: Axis, speed: float, *, still: bool) -> None:
        if abs(speed) > axis.velocity_limit:
            raise OutOfRange(
                f"wheel '{axis.name}' exceeds allowed range: "
                f"{speed:g} rad/s > {axis.velocity_limit:g} rad/s"
            )
        if axis.owner is not None:
            raise ModeForbids(f"motor '{axis.name}' is driven by {axis.owner}")
        if still:
            check_link(axis)
        else:
            check(axis)
