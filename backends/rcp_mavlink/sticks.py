"""The sticks of a transmitter, given by a client: repeated while they are valid, then released."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import PreconditionFailed, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import check_fence, fenced_off
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.hub import Hub
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ChannelPulses", "StickPositions", "Sticks"]

_RATE = 10.0  # Hz: PX4 counts sticks as lost after 0.5 s
_CHANNELS, _LOWER = 18, 8
_RELEASE, _RELEASE_UPPER = 0, 65534  # of the first eight channels, and of the others
_SPAN, _MIDDLE = 1000, 500  # of MANUAL_CONTROL, whose throttle goes from 0

Deflection = Annotated[float, Meta(ge=-1, le=1, extra_json_schema={"unit": "1"})]
Pulse = Annotated[int, Meta(ge=800, le=2200, extra_json_schema={"unit": "us"})]


class StickPositions(Struct, frozen=True, forbid_unknown_fields=True):
    """Deflections as on a transmitter; all centred is rest.

    A rover or boat with ArduPilot is steered by `yaw`, or by `roll` if that is centred.
    """

    roll: Deflection = 0.0
    """Positive to the right."""
    pitch: Deflection = 0.0
    """Positive forward, which lowers the nose."""
    throttle: Deflection = 0.0
    """Positive up, or forward on the ground; centred keeps the height in the modes that hold one."""
    yaw: Deflection = 0.0
    """Positive to the right, clockwise."""
    buttons: Annotated[int, Meta(ge=0, le=65535, extra_json_schema={"unit": "1"})] = 0
    """Pressed buttons as bits, whose meaning the vehicle's parameters tell."""


class ChannelPulses(Struct, frozen=True, forbid_unknown_fields=True):
    """Pulse widths of channels that replace those of the transmitter; none is rest."""

    channels: Annotated[tuple[Pulse | None, ...], Meta(max_length=_CHANNELS)] = ()
    """From channel 1; null, and what is missing, is left to the transmitter."""


class Sticks:
    """The sticks of one vehicle; new ones replace the previous."""

    def __init__(self, hub: Hub, vehicle: Vehicle, motion: Motion) -> None:
        self._hub, self._vehicle, self._motion = hub, vehicle, motion
        self._task: asyncio.Task[None] | None = None
        self._make: Callable[[], Any] = lambda: None

    @staticmethod
    def resources(family: Family) -> list[Resource]:
        """List what it serves; PX4 takes every channel of an override, so none can be left out."""
        found = [
            Resource(
                name="actuator/sticks",
                description="Sticks of a transmitter, by MANUAL_CONTROL; what they do depends on the mode. At the end they are released, and the vehicle holds.",
                value=StickPositions, examples=({"pitch": 0.3}, {"throttle": 0.2, "yaw": -0.5}),
                live=True, max_age=1.0, valid_for=0.5, safe={},
            )
        ]  # fmt: skip
        if not family.px4:
            found.append(
                Resource(
                    name="actuator/rc",
                    description="Pulse widths that replace channels of the transmitter, by RC_CHANNELS_OVERRIDE. At the end they are released, and the vehicle holds.",
                    value=ChannelPulses, examples=({"channels": [1500, 1400, 1500, 1500]}, {"channels": [None, None, None, 1600]}),
                    live=True, max_age=1.0, valid_for=0.5, safe={},
                )
            )  # fmt: skip
        return found

    async def positions(self, value: StickPositions) -> None:
        """Send deflections as long as they are valid."""
        if value == StickPositions():
            await self._rest()
            return
        await self._send(lambda: self._manual(value))

    async def pulses(self, value: ChannelPulses) -> None:
        """Send pulse widths as long as they are valid."""
        if all(pulse is None for pulse in value.channels):
            await self._rest()
            return
        await self._send(lambda: self._override(value))

    async def _send(self, make: Callable[[], Any]) -> None:
        vehicle = self._vehicle
        if not vehicle.armed:  # throttle down and yaw to the right would arm it, past `action/arm`
            raise PreconditionFailed(
                "sticks: the vehicle is not armed", remedy="Arm it with action/arm first."
            )
        self._motion.measurement.check(strict=False)
        check_fence()
        if self._task is not None and type(make()) is not type(self._make()):
            self._release()
        self._make = make
        self._hub.send(vehicle, make())
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._repeat())

    async def _repeat(self) -> None:
        vehicle = self._vehicle
        while True:
            await asyncio.sleep(1 / _RATE)
            stale = self._motion.measurement.stale(strict=False)
            if fenced_off() or vehicle.lost or not vehicle.armed or stale:
                break
            self._hub.send(vehicle, self._make())
        self._task = None
        self._release()
        if stale and not fenced_off():
            with suppress(RcpError):
                await self._motion.shielded(self._motion.hold)

    async def _rest(self) -> None:
        """Release the sticks, and hold if they were in use."""
        if self._task is not None:
            self.end()
            await self._motion.hold()

    def end(self) -> None:
        """Release the sticks."""
        if self._task is None:
            return
        self._task.cancel()
        self._task = None
        self._release()

    # Messages

    def _manual(self, value: StickPositions) -> Any:
        roll, throttle = value.roll, round(_MIDDLE + value.throttle * _MIDDLE)
        family = self._vehicle.family
        if family.drives and not family.px4:  # its throttle goes both ways, and `y` alone steers
            roll, throttle = value.yaw or value.roll, round(value.throttle * _SPAN)
        return self._hub.dialect.module.MAVLink_manual_control_message(
            self._vehicle.system, round(value.pitch * _SPAN), round(roll * _SPAN),
            throttle, round(value.yaw * _SPAN), value.buttons,
        )  # fmt: skip

    def _override(self, value: ChannelPulses) -> Any:
        given = (*value.channels, *[None] * (_CHANNELS - len(value.channels)))
        pulses = [
            (_RELEASE if channel < _LOWER else _RELEASE_UPPER) if pulse is None else pulse
            for channel, pulse in enumerate(given)
        ]
        return self._hub.dialect.module.MAVLink_rc_channels_override_message(
            self._vehicle.system, self._vehicle.component, *pulses
        )

    def _release(self) -> None:
        """Give every channel back to the transmitter, those that MANUAL_CONTROL sets too.

        PX4 would take the values that release a channel as deflections; it waits 0.5 s instead.
        """
        if not self._vehicle.family.px4:
            self._hub.send(self._vehicle, self._override(ChannelPulses()), urgent=True)
