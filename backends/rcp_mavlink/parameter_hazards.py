"""Parameters that may move or energise a vehicle by themselves, which an e-stop therefore bars."""

from __future__ import annotations

import re
from collections.abc import Iterable

from rcp_kernel.errors import EstopActive
from rcp_kernel.spi import check_fence

__all__ = ["check_latched", "check_sent", "is_hazard"]

_TOLD = 5  # names in a message

# Both firmwares apply a parameter at once. ArduPilot counts as armed while ARMING_REQUIRE is 0, and
# sends MOT_PWM_MIN, SERVOn_TRIM and the like to outputs of a disarmed vehicle; PX4 sends PWM_*_DIS*.
_FAMILIES = (
    # What an output carries, and its pulse: also of a disarmed vehicle.
    r"SERVO\d*_.*", r"MOT_.*", r"Q_M_.*", r"Q_TILT_.*", r"H_.*", r"RELAY\d*_.*", r"FRAME_.*",
    r"ESC_.*", r"ICE_.*", r"WINCH_.*", r"GRIP_.*", r"CHUTE_.*", r"LGR_.*", r"SPRAY_.*",
    r"CAN_D\d_UC_.*", r"MNT.*", r"THR_.*", r"SAIL_.*",
    r"PWM_.*", r"HIL_ACT_.*", r"UAVCAN_.*", r"DSHOT_.*", r"CA_.*", r"VOXL.*", r"TAP_ESC_.*",
    r"PCA9685_.*", r"RBCLW_.*", r"VTQ_.*", r".*_(DIS|FUNC|MIN|MAX|FAIL)\d+", r".*_REV\d*",
    # Arming without a command, and what a switch or stick of a remote control does.
    r"ARMING_.*", r"BRD_SAFETY.*", r"RC\d*_.*", r"RCMAP_.*",
    r"FLTMODE\d*(_.*)?", r"MODE(\d+|_CH)", r"FLIGHT_MODE\d+", r"CH\d+_OPT(ION)?", r"INITIAL_MODE",
    r"BTN\d+_S?FUNCTION",
    r"COM_ARM.*", r"COM_PREARM_.*", r"COM_FLTMODE\d+", r"COM_RC_.*", r"COM_KILL_.*", r"CBRK_.*",
    r"MAN_.*",
    # Programs on the vehicle, and a simulated one's world.
    r"SCR_.*", r"SYS_HITL", r"SYS_AUTOSTART", r"SYS_AUTOCONFIG", r"SIM_.*",
)  # fmt: skip
_HAZARDS = re.compile("|".join(_FAMILIES))


def is_hazard(name: str) -> bool:
    """Return whether writing a parameter may move or energise a disarmed vehicle."""
    return _HAZARDS.fullmatch(name) is not None


def check_latched(names: Iterable[str], *, armed: bool) -> None:
    """Refuse parameters that may move a stopped vehicle: when it is armed, all of them.

    Whatever changes a limit, a failsafe or an estimate may end the hold that the stop commands: a
    battery failsafe flies home.

    :raises EstopActive: some of them may.
    """
    found = sorted(name for name in names if armed or is_hazard(name))
    if not found:
        return
    more = f" and {len(found) - _TOLD} more" if len(found) > _TOLD else ""
    why = ", which is armed" if armed else ""
    raise EstopActive(
        f"an e-stop is latched, and {', '.join(found[:_TOLD])}{more} may move the vehicle{why}",
        remedy=("Disarm it" if armed else "Leave them out") + ", or reset the e-stop first.",
    )


def check_sent(name: str, *, armed: bool) -> None:
    """Check the fence of a parameter that may move the vehicle, just before it is sent.

    :raises EstopActive: its request was cancelled by a stop.
    """
    if armed or is_hazard(name):
        check_fence()
