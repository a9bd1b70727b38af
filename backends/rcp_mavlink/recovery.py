"""What to do when the link is restored with a vehicle whose command ended with the link."""

from __future__ import annotations

from rcp_kernel.errors import DeviceRejected, DeviceTimeout
from rcp_mavlink.motion import Motion
from rcp_mavlink.stop import Stop
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Recovery"]

_KNOWN = 5.0  # s for its first heartbeat


class Recovery:
    """Applies `on_loss` to one vehicle, confirmed by telemetry."""

    def __init__(self, vehicle: Vehicle, motion: Motion, stop: Stop) -> None:
        self._vehicle, self._motion, self._stop = vehicle, motion, stop

    async def run(self, policy: str) -> str:
        """Apply it; return a description of what was done.

        :raises AdapterUnavailable: the vehicle is lost again.
        :raises DeviceTimeout: telemetry does not confirm it.
        """
        vehicle, measurement = self._vehicle, self._motion.measurement
        if not await vehicle.until(lambda: measurement.has_heartbeat, _KNOWN):
            raise DeviceTimeout("the vehicle sends messages, but no heartbeat")
        if not vehicle.armed:
            return "disarmed: nothing to do"
        if measurement.standing:
            return "on the ground: nothing to do"
        if policy == "continue":
            return f"continues in {vehicle.mode}"
        family = vehicle.family
        mode = {"land": family.land, "return": family.rtl}.get(policy, "")
        refused = ""
        if mode:
            try:
                await self._motion.to_mode(mode, surely=True, urgent=True)
            except DeviceRejected as error:
                refused = f"{error}; "
            else:
                return f"commanded to {policy}: in {mode}"
        await self._stop.hold()
        return f"{refused}holds in {vehicle.mode}"
