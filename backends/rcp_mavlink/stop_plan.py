"""What the guard process sends to a vehicle when the gateway's event loop hangs."""

from __future__ import annotations

from typing import Any

import structlog

from rcp_kernel.spi import Host, StopPlan, Watchdog
from rcp_mavlink.hub import Hub
from rcp_mavlink.ladder import Rung, ladder
from rcp_mavlink.stop import Stop
from rcp_mavlink.vehicle import Vehicle

__all__ = ["GuardPlan"]

log = structlog.get_logger("rcp.mavlink")
_PERIOD = 0.2  # s
_LASTS = 1.0  # s: some seconds later the vehicle's failsafe acts, once, and must not be overridden
_CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_SET_MODE = 176
_WITHIN = 0.7  # s: the guard waits 0.5 s, then sends every 0.2 s


class GuardPlan:
    """Keeps the guard's plan for one vehicle up to date, with prebuilt frames."""

    def __init__(
        self, hub: Hub, vehicle: Vehicle, host: Host, stop: Stop, robot: str | None
    ) -> None:
        self._hub, self._vehicle, self._host, self._stop = hub, vehicle, host, stop
        self._robot, self._name = robot, robot or f"vehicle{vehicle.system}"
        self._given: Any = None
        self._why_none = ""

    @property
    def watchdog(self) -> Watchdog:
        """What the guard can do for this vehicle."""
        why = self._why_not(self._address())
        if why:
            return Watchdog(f"guard process: none, {why}", None, robot=self._robot)
        return Watchdog("guard process: holding mode, over UDP", _WITHIN, robot=self._robot)

    def renew(self) -> None:
        """Update the guard's plan if the address, the vehicle or the stop has changed."""
        vehicle, address = self._vehicle, self._address()
        rung = self._rung()
        why = self._why_not(address)
        if why and why != self._why_none:
            log.warning("no_guard", vehicle=self._name, why=why)
        self._why_none = why
        # A disarmed vehicle does not move, and a flight mode would outlast its purpose.
        wanted = not why and vehicle.may_be_armed and rung is not None
        key = (address, vehicle.component, vehicle.family, rung) if wanted else None
        if key == self._given:
            return
        self._given = key
        if key is None or address is None or rung is None:
            self._host.guard(self._name, None)
            return
        data = {"to": list(address), "frames": [f.hex() for f in self._frames(rung)]}
        self._host.guard(self._name, StopPlan("udp", data, _PERIOD, _LASTS))

    def take_back(self) -> None:
        """Withdraw the plan of a vehicle that the gateway releases."""
        if self._given is not None:
            self._given = None
            self._host.guard(self._name, None)

    def _rung(self) -> Rung | None:
        """Return the step to send: the stop's own if one is in effect, otherwise one that holds.

        Never one that stops the motors: a hung process is no reason to let a vehicle fall.
        """
        rung = self._stop.rung
        vehicle = self._vehicle
        if self._stop.in_force and rung.mode:
            return rung
        holding = ladder(("hold", "level"), vehicle.family, hovering=vehicle.hovering)
        return holding[0] if holding else None

    def _address(self) -> tuple[str, int] | None:
        """Return the UDP address of the vehicle; None if it is not connected over UDP."""
        routes = self._vehicle.routes.values()
        if not routes:
            return None
        link, address, _ = max(routes, key=lambda route: route[2])
        match link.spec.kind:
            case "udpin" | "sim":
                return address[0], address[1]
            case "udpout":
                return link.spec.host, link.spec.port
            case _:
                return None

    def _why_not(self, address: tuple[str, int] | None) -> str:
        if self._hub.config.key is not None:
            return "the link is signed, and frames cannot be signed in advance"
        return "" if address is not None else "the link is not UDP"

    def _frames(self, rung: Rung) -> list[bytes]:
        """Build the stop twice: as a command, and as the message for older autopilots."""
        hub, vehicle = self._hub, self._vehicle
        module = hub.dialect.module
        number = vehicle.family.number(rung.mode)
        if number is None:
            return []
        mav = module.MAVLink(None, hub.config.source_system, hub.config.source_component)
        params = (1.0, float(number), 0.0, 0.0)
        if vehicle.family.px4:
            params = (1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF), 0.0)
        to = (vehicle.system, vehicle.component)
        command = module.MAVLink_command_long_message(
            *to, _SET_MODE, 0, *params, 0.0, 0.0, 0.0
        )  # fmt: skip
        message = module.MAVLink_set_mode_message(vehicle.system, _CUSTOM_MODE, number)
        return [bytes(m.pack(mav)) for m in (command, message)]
