"""Detection of the motor of a VESC, as VESC Tool's wizard begins it: COMM_DETECT_APPLY_ALL_FOC.

The firmware measures resistance, inductance and flux linkage, for which it turns the motor open loop,
looks for sensors, derives the motor's current limit from a power loss, and stores all that. Meanwhile it
ignores set-points, brakes and its time-out; only a reboot ends it, after which it has its old settings,
unless it had stored already: in its last two seconds it does, with a second's pause after each part.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple, Protocol

from msgspec import Meta, Struct

from rcp_can.motor_messages import Seconds
from rcp_can.procedure import Procedure
from rcp_can.profiles.vesc_settings import GET_APP, SET_APP, PacketDrive, VescSettings
from rcp_kernel.errors import DeviceRejected, RcpError
from rcp_kernel.spi import Progress

__all__ = [
    "ALIVE",
    "DETECT",
    "GET_MOTOR",
    "LAYOUTS",
    "LONGEST",
    "PRINT",
    "REBOOT",
    "TERMINAL",
    "DetectMotor",
    "MotorDetected",
    "detection_procedure",
    "put_back",
]

GET_MOTOR, TERMINAL, PRINT, REBOOT, DETECT = 14, 20, 21, 29, 58
"""COMM_GET_MCCONF, …_TERMINAL_CMD, …_PRINT, …_REBOOT, …_DETECT_APPLY_ALL_FOC of the firmware."""
ALIVE = bytes((TERMINAL,)) + b"ping"
"""A command that the firmware discards while a detection runs, and answers with `pong` otherwise."""
_LONGEST = 180.0  # s
LONGEST = _LONGEST + 20.0  # s, with what is read and written around it
_STORES = 3.0  # s
_FAULT, _FAULTS = -100, 45
"""A result above -100 is a fault code less 100 (firmware 6)."""
_REASONS = {
    -1: "a fault of the drive did not go away",
    -10: "the flux linkage could not be measured: the motor did not turn freely, or `power_loss` is too small for it",
    -11: "the drive entered a fault while it measured",
}
_SENSORS: tuple[Literal["sensorless", "hall", "encoder"], ...] = ("sensorless", "hall", "encoder")
_REQUEST = struct.Struct(">BB5i")


class _Layout(NamedTuple):
    """Where values are in the motor's configuration, after the command."""

    size: int
    current_max: int
    inductance: int
    resistance: int
    flux_linkage: int
    openloop_erpm: int
    sensorless_erpm: int


LAYOUTS = {776184161: _Layout(481, 8, 161, 169, 173, 201, 235)}
"""By signature; that of firmware 6.00."""


class DetectMotor(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the motor may take."""

    power_loss: Annotated[float, Meta(gt=0, le=2000, extra_json_schema={"unit": "W"})]
    """Heat in the motor at its highest current: it sets that limit, and the currents of the detection. VESC Tool suggests 10 (small) to 400 (large)."""


class MotorDetected(Struct, frozen=True, kw_only=True):
    """What was measured, and is stored."""

    sensors: Literal["sensorless", "hall", "encoder"]
    duration: Seconds
    resistance: Annotated[float, Meta(extra_json_schema={"unit": "Ω"})] | None = None
    """This and the next are null if the drive's firmware has another layout than is known."""
    inductance: Annotated[float, Meta(extra_json_schema={"unit": "H"})] | None = None
    flux_linkage: Annotated[float, Meta(extra_json_schema={"unit": "Wb"})] | None = None
    current_max: Annotated[float, Meta(extra_json_schema={"unit": "A"})] | None = None
    torque_constant: Annotated[float, Meta(extra_json_schema={"unit": "N·m/A"})] | None = None
    """By `pole_pairs`; set the option of the motor to it."""


class DetectingDrive(PacketDrive, Protocol):
    """A drive that detects its motor."""

    pole_pairs: int

    async def detect(self, request: bytes, seconds: float) -> bytes:
        """Return the answer to a detection; however it ends, see that the drive ends it."""
        ...

    async def restore(self) -> None:
        """Put back the application's configuration, now or later."""
        ...


def detection_procedure(drive: DetectingDrive) -> Sequence[Procedure]:
    """Return the procedure."""

    async def run(wanted: DetectMotor, _progress: Progress) -> MotorDetected:
        began = time.monotonic()
        await VescSettings(drive).prepare()
        application = (await drive.ask(bytes((GET_APP,))))[1:]
        request = await _request(drive, wanted.power_loss)
        drive.application = application
        answer = await drive.detect(request, _LONGEST)
        try:
            await drive.restore()
            sensors = _outcome(answer)
            measured = await _measured(drive)
        except RcpError as error:  # what moved is no refusal
            error.status = "failed" if error.status == "rejected" else error.status
            raise
        return MotorDetected(sensors=sensors, duration=time.monotonic() - began, **measured)

    return (
        Procedure(
            "detect_motor",
            "Measure its motor and sensors, and store what was measured with the current limit that "
            "follows: the drive turns the motor by itself, which must be free to spin. A stop makes it "
            "reboot, with its old settings unless it had stored already, and the motor coasts.",
            run,
            needs="disabled",
            motion="own",
            input=DetectMotor,
            output=MotorDetected,
            examples=({"power_loss": 60.0},),
            timeout=LONGEST,
        ),
    )


async def _request(drive: DetectingDrive, power_loss: float) -> bytes:
    """Return the command. What it would set to the firmware's defaults keeps its present value, if known."""
    limits = await VescSettings(drive).read_all(lambda _part: None)
    least, most = (float(limits[f"l_in_current_{which}"]) for which in ("min", "max"))
    openloop = sensorless = 0.0
    motor = await drive.ask(bytes((GET_MOTOR,)))
    if (layout := _layout(motor)) is not None:
        openloop = _float(motor, layout.openloop_erpm)
        sensorless = _float(motor, layout.sensorless_erpm)
    values = (power_loss, least, most, openloop, sensorless)
    if not all(math.isfinite(each) and abs(each) < 2**31 / 1e3 for each in values):
        raise DeviceRejected(
            "the drive's present limits cannot be sent back to it",
            remedy="Set its battery currents (service/…/load_settings), or use VESC Tool.",
        )
    return _REQUEST.pack(DETECT, False, *(round(each * 1e3) for each in values))


def _outcome(answer: bytes) -> Literal["sensorless", "hall", "encoder"]:
    if len(answer) < 3:
        raise DeviceRejected("the drive does not tell how its detection ended")
    (result,) = struct.unpack_from(">h", answer, 1)
    if result < 0:
        reason = _REASONS.get(result, f"result {result}")
        if 0 < result - _FAULT < _FAULTS:
            reason = f"fault {result - _FAULT} of the drive (mc_fault_code)"
        raise DeviceRejected(
            f"the detection failed: {reason}",
            remedy="The drive has its old settings. Check wiring, supply and that the motor turns freely.",
        )
    if result >= len(_SENSORS):
        raise DeviceRejected(f"the detection ended with the unknown result {result}")
    return _SENSORS[result]


async def put_back(drive: DetectingDrive) -> None:
    """Restore the application's configuration: a detection changes which status messages are sent.

    :raises DeviceRejected: the drive keeps another one.
    """
    application = drive.application
    if application is None:
        return
    if (await drive.ask(bytes((GET_APP,))))[1:] == application:
        drive.application = None
        return
    await drive.ask(bytes((SET_APP,)) + application, seconds=_STORES, once=True)
    if (await drive.ask(bytes((GET_APP,))))[1:] != application:
        raise DeviceRejected("the drive does not take its status messages back")
    drive.application = None


async def _measured(drive: DetectingDrive) -> dict[str, float]:
    motor = await drive.ask(bytes((GET_MOTOR,)))
    if (layout := _layout(motor)) is None:
        return {}
    linkage = _float(motor, layout.flux_linkage)
    return {
        "resistance": _float(motor, layout.resistance),
        "inductance": _float(motor, layout.inductance),
        "flux_linkage": linkage,
        "current_max": _float(motor, layout.current_max),
        "torque_constant": 1.5 * drive.pole_pairs * linkage,
    }


def _layout(motor: bytes) -> _Layout | None:
    layout = LAYOUTS.get(int.from_bytes(motor[1:5], "big"))
    return layout if layout is not None and len(motor) == 1 + layout.size else None


def _float(motor: bytes, place: int) -> float:
    return struct.unpack_from(">f", motor, 1 + place)[0]
