"""The vehicle's own failsafes for a silent gateway: read, enabled if configured, and reported."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import NamedTuple

import structlog

from rcp_kernel.errors import RcpError
from rcp_kernel.spi import Watchdog
from rcp_mavlink.config import MavlinkConfig
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Watchdogs"]

log = structlog.get_logger("rcp.mavlink")
_BEAT = 1.0  # s between two heartbeats of the gateway
_CONTINUE_IN_AUTO, _CONTINUE_IF_PILOTED = 2, 16  # FS_OPTIONS


class _Failsafe(NamedTuple):
    """A failsafe with a parameter that enables it and one for its time-out."""

    switches: tuple[str, ...]
    """Its names in different firmware versions."""
    timers: tuple[str, ...]
    usual: float
    """Time-out in seconds, if no parameter has it."""
    actions: dict[str, int]
    """The value to set, by `on_loss`."""


_COPTER = {"hold": 5, "land": 5, "return": 1}  # holding without a limit would drain the battery
_ENABLED = {"hold": 1, "land": 1, "return": 1}
_SUB = {"hold": 3, "land": 4, "return": 4}
_PX4 = {"hold": 1, "land": 3, "return": 2}
_STATION = ("FS_GCS_ENABLE", "FS_GCS_ENABL")
_STATION_TIMERS = ("FS_GCS_TIMEOUT", "FS_LONG_TIMEOUT", "FS_TIMEOUT")
_OBEYED = ("MAV_GCS_SYSID", "SYSID_MYGCS")
_OBEYED_TO = "MAV_GCS_SYSID_HI"


class Watchdogs:
    """The failsafes of one vehicle, according to its parameters."""

    def __init__(
        self, vehicle: Vehicle, config: MavlinkConfig, parameters: Parameters, robot: str | None
    ) -> None:
        self._vehicle, self._config, self._parameters = vehicle, config, parameters
        self._robot = robot
        self.found: Sequence[Watchdog] = (
            Watchdog("failsafes of the autopilot: not read yet", None, robot=robot),
        )
        self._warned: tuple[str, ...] = ()
        self.verified = asyncio.Event()
        """Set once they have been checked."""

    async def verify(self) -> None:
        """Read the failsafes, enable them if configured, and warn if there are none."""
        if self._config.watchdog == "off":
            self.found = ()
            return
        px4 = self._vehicle.family.px4
        self.found = await (self._of_px4() if px4 else self._of_ardupilot())
        missing = tuple(dog.mechanism for dog in self.found if dog.within is None)
        if missing and missing != self._warned:
            log.warning("no_watchdog", vehicle=self._vehicle.system, missing=list(missing))
        self._warned = missing
        self.verified.set()

    def _value(self, *names: str) -> tuple[str, float] | None:
        """Return the first existing parameter, with its value."""
        for name in names:
            known = self._parameters.known.get(name)
            if known is not None:
                return name, known.value
        return None

    async def _on(self, failsafe: _Failsafe) -> tuple[str, float] | None:
        """Return the value that enables a failsafe, after setting it if configured."""
        switch = self._value(*failsafe.switches)
        wanted = failsafe.actions.get(self._config.on_loss)
        if switch is None or switch[1] or wanted is None or self._config.watchdog != "set":
            return switch
        name = switch[0]
        try:
            value = await self._parameters.write(name, wanted)
        except RcpError as error:
            log.warning(
                "watchdog_not_set", vehicle=self._vehicle.system, parameter=name, error=str(error)
            )
            return switch
        log.info("watchdog_set", vehicle=self._vehicle.system, parameter=name, value=value)
        return name, value

    def _described(
        self, what: str, failsafe: _Failsafe, switch: tuple[str, float] | None
    ) -> Watchdog:
        if switch is None:
            return Watchdog(
                f"{what}: the vehicle has no {failsafe.switches[0]}", None, robot=self._robot
            )
        if not switch[1]:
            return Watchdog(f"{what}: off ({switch[0]}=0)", None, verified=True, robot=self._robot)
        timer = self._value(*failsafe.timers)
        seconds = failsafe.usual if timer is None else timer[1]
        of = "" if timer is None else f", {timer[0]}={timer[1]:g}"
        text = f"{what} ({switch[0]}={switch[1]:g}{of})"
        return Watchdog(text, seconds + _BEAT, verified=True, robot=self._robot)

    # ArduPilot

    async def _of_ardupilot(self) -> list[Watchdog]:
        kind = self._vehicle.family.kind
        actions = {"copter": _COPTER, "sub": _SUB}.get(kind, _ENABLED)
        failsafe = _Failsafe(_STATION, _STATION_TIMERS, 5.0, actions)
        watchdog = self._described("ArduPilot GCS failsafe", failsafe, await self._on(failsafe))
        found = [self._limited(watchdog)]
        if (timeout := self._value("GUID_TIMEOUT")) is not None:
            found.append(
                Watchdog(
                    f"ArduPilot guided timeout, velocity and attitude only (GUID_TIMEOUT={timeout[1]:g})",
                    timeout[1], verified=True, robot=self._robot,
                )
            )  # fmt: skip
        elif self._vehicle.family.drives:
            text = "ArduPilot guided timeout, velocity only (fixed)"
            found.append(Watchdog(text, 3.0, robot=self._robot))
        return found

    def _limited(self, watchdog: Watchdog) -> Watchdog:
        """Mark a failsafe as ineffective if it ignores this gateway or does nothing."""
        if watchdog.within is None:
            return watchdog
        own, obeyed = self._config.source_system, self._value(*_OBEYED)
        if obeyed is not None:
            last = self._value(_OBEYED_TO)
            most = max(obeyed[1], 0.0 if last is None else last[1])
            if not obeyed[1] <= own <= most:
                return Watchdog(
                    f"{watchdog.mechanism}, but it accepts another ground station ({obeyed[0]}="
                    f"{obeyed[1]:g}, the gateway is {own})", None, verified=True, robot=self._robot,
                )  # fmt: skip
        for name in ("FS_LONG_ACTN", "FS_ACTION"):
            action = self._value(name)
            if action is not None and not action[1] and self._vehicle.family.kind != "copter":
                text = f"{watchdog.mechanism}, but it does nothing ({name}=0)"
                return Watchdog(text, None, verified=True, robot=self._robot)
        options = self._value("FS_OPTIONS")
        if options is None or self._vehicle.family.kind != "copter":
            return watchdog
        excepted = {
            _CONTINUE_IN_AUTO: "a mission continues",
            _CONTINUE_IF_PILOTED: "a vehicle in BRAKE or LOITER keeps holding",
        }
        but = [why for bit, why in excepted.items() if int(options[1]) & bit]
        if but:
            text = f"{watchdog.mechanism}, but {' and '.join(but)} (FS_OPTIONS={options[1]:g})"
            return Watchdog(text, watchdog.within, verified=True, robot=self._robot)
        return watchdog

    # PX4

    async def _of_px4(self) -> list[Watchdog]:
        link = _Failsafe(("NAV_DLL_ACT",), ("COM_DL_LOSS_T",), 10.0, _PX4)
        found = [self._described("PX4 data link loss", link, await self._on(link))]
        timer, action = self._value("COM_OF_LOSS_T"), self._value("COM_OBL_RC_ACT", "COM_OBL_ACT")
        if timer is not None:
            does = "" if action is None else f", {action[0]}={action[1]:g}"
            text = f"PX4 offboard loss ({timer[0]}={timer[1]:g}{does})"
            found.append(Watchdog(text, timer[1], verified=True, robot=self._robot))
        return found
