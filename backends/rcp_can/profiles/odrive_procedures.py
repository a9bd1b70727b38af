"""What sets up an ODrive: calibration, and storing of its configuration."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Literal, Protocol

from msgspec import Meta, Struct

from rcp_can.motor_messages import Seconds
from rcp_can.procedure import Procedure
from rcp_can.profiles.odrive_states import CALIBRATIONS, STATES
from rcp_kernel.spi import Progress

__all__ = ["Calibrate", "Calibrated", "CalibrationFeedback", "odrive_procedures"]

_LONGEST = 600.0  # s of a calibration
_STORING = 15.0  # s


class Calibrate(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which calibration; `full` is that of motor and encoder."""

    sequence: Literal[
        "full",
        "motor",
        "index_search",
        "encoder_offset",
        "encoder_direction",
        "hall_polarity",
        "hall_phase",
        "anticogging",
    ] = "full"
    timeout: Annotated[float, Meta(gt=0, le=_LONGEST, extra_json_schema={"unit": "s"})] = 60.0


class CalibrationFeedback(Struct, frozen=True, kw_only=True):
    """The state that the drive has entered."""

    state: str


class Calibrated(Struct, frozen=True, kw_only=True):
    """The states that the drive was seen to go through, before it was idle again without an error."""

    states: list[str]
    duration: Seconds


class _Drive(Protocol):
    """A drive that calibrates itself."""

    async def calibrate(
        self, state: int, seconds: float, tell: Callable[[int], None], begun: Callable[[], object]
    ) -> None:
        """Run a calibration to its end; tell its states, and that it has begun."""
        ...

    async def save(self) -> None:
        """Store the configuration."""
        ...


def odrive_procedures(drive: _Drive) -> Sequence[Procedure]:
    """List the procedures of an ODrive."""

    async def calibrate(wanted: Calibrate, progress: Progress) -> Calibrated:
        states: list[str] = []
        began = time.monotonic()

        def tell(state: int) -> None:
            states.append(STATES[state])
            progress(CalibrationFeedback(state=states[-1]))

        await drive.calibrate(CALIBRATIONS[wanted.sequence], wanted.timeout, tell, progress)
        return Calibrated(states=states, duration=time.monotonic() - began)

    async def save(_value: None, _progress: Progress) -> None:
        await drive.save()

    return (
        Procedure(
            "calibrate",
            "Calibrate its motor and encoder: the drive turns the motor by itself; ends at idle.",
            calibrate,
            needs="disabled",
            motion="own",
            input=Calibrate,
            output=Calibrated,
            feedback=CalibrationFeedback,
            examples=({"sequence": "full"},),
            timeout=_LONGEST,
        ),
        Procedure(
            "save_configuration",
            "Store its configuration; completes when it has rebooted, which it does once it has.",
            save,
            needs="disabled",
            timeout=_STORING,
        ),
    )
