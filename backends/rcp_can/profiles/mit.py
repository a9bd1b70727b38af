"""MIT protocol: mini-cheetah and T-Motor AK. Eight bytes of bit fields, ranges by model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, NamedTuple

from msgspec import Meta

from rcp_can.bus import Bus, Route
from rcp_can.codec import Packed, Span
from rcp_can.drive import Fault, Profile, Protection, Reach, StopFrame
from rcp_can.profiles.impedance import FAST, Gains, ImpedanceDrive
from rcp_can.profiles.torque_rounding import TorqueRounding

if TYPE_CHECKING:
    import can

__all__ = [
    "MIT",
    "MODELS",
    "TMOTOR",
    "MitDrive",
    "MitOptions",
    "Ranges",
    "command_codec",
    "fault_of",
    "reply_codec",
]

_ENABLE, _DISABLE, _ZERO = 0xFC, 0xFD, 0xFE


class Ranges(NamedTuple):
    """The full-scale values of a model: ± rad, ± rad/s, ± N·m."""

    position: float
    velocity: float
    torque: float


MODELS = {
    "mini-cheetah": Ranges(12.5, 65, 18),
    "AK10-9": Ranges(12.5, 50, 65),
    "AK60-6": Ranges(12.5, 45, 15),
    "AK70-10": Ranges(12.5, 50, 25),
    "AK80-6": Ranges(12.5, 76, 12),
    "AK80-8": Ranges(12.5, 37.5, 32),
    "AK80-9": Ranges(12.5, 50, 18),
    "AK80-64": Ranges(12.5, 8, 144),
    "3507": Ranges(12.566, 50, 5),
    "4310": Ranges(12.5, 30, 10),
    "4310P": Ranges(12.5, 50, 10),
    "4340": Ranges(12.5, 10, 28),
    "6006": Ranges(12.5, 45, 20),
    "8006": Ranges(12.5, 45, 40),
    "8009": Ranges(12.5, 45, 54),
    "10010": Ranges(12.5, 20, 200),
    "10010L": Ranges(12.5, 25, 200),
    "H3510": Ranges(12.5, 280, 1),
    "G6215": Ranges(12.5, 45, 10),
}
KP, KD = 500.0, 5.0


def command_codec(ranges: Ranges) -> Packed:
    """Return the payload of a set-point."""
    p, v, t = ranges
    return Packed(
        Span("position", 16, -p, p),
        Span("velocity", 12, -v, v),
        Span("kp", 12, 0.0, KP),
        Span("kd", 12, 0.0, KD),
        Span("torque", 12, -t, t),
    )


def reply_codec(ranges: Ranges, *more: Span) -> Packed:
    """Return the payload of a response, with the fields that some makes append."""
    p, v, t = ranges
    return Packed(
        Span("id", 8),
        Span("position", 16, -p, p),
        Span("velocity", 12, -v, v),
        Span("torque", 12, -t, t),
        *more,
    )


class MitOptions(Gains, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gains, the model or its ranges, and the identifier of responses."""

    model: str = "mini-cheetah"
    ranges: tuple[float, float, float] | None = None
    """± rad, ± rad/s, ± N·m, for an unlisted model."""
    reply_id: Annotated[int, Meta(ge=0, le=0x7FF)] = 0
    """Identifier of its responses."""

    def __post_init__(self) -> None:
        if self.ranges is None and self.model not in MODELS:
            raise ValueError(
                f"unknown model {self.model!r}; set `ranges`, or use one of {', '.join(MODELS)}"
            )

    @property
    def span(self) -> Ranges:
        """The ranges used."""
        return Ranges(*self.ranges) if self.ranges else MODELS[self.model]


class MitDrive(ImpedanceDrive):
    """A mini-cheetah actuator: it reports position, velocity and torque, but not its own state.

    It therefore counts as enabled while it responds after the last enable command.
    """

    extra: tuple[Span, ...] = ()

    def __init__(self, node: int, options: MitOptions, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self.span = options.span
        self._command, self._reply = command_codec(self.span), reply_codec(self.span, *self.extra)
        self._rounding = TorqueRounding(self._command)
        self._on = False
        self._answers = 0
        self.protection = Protection("no watchdog: it keeps its last set-point")

    def routes(self) -> tuple[Route, ...]:
        """Return the shared response identifier; the first byte tells which drive responded."""
        return (Route(self.options.reply_id),)

    def reach(self) -> Reach:
        """Return the model's ranges."""
        return Reach(*self.span)

    def take(self, message: can.Message) -> bool:
        """Decode a response."""
        values = self._reply.decode(message.data)
        identifier = int(values.pop("id"))
        if not self._mine(identifier):
            return False
        status = self.status
        status.position, status.velocity = values.pop("position"), values.pop("velocity")
        status.torque = values.pop("torque")
        status.enabled = self._on
        self._more(identifier, **values)
        self.answered()
        self._answers += 1
        status.moved += 1
        status.reports += 1
        return True

    def _mine(self, identifier: int) -> bool:
        return identifier == self.node

    def _more(self, identifier: int, **values: float) -> None:
        """Decode the additional fields of a make."""

    def _special(self, code: int, *, urgent: bool = False) -> None:
        self.count_query()
        self.send(self.node, b"\xff" * 7 + bytes((code,)), urgent=urgent)

    def impede(
        self,
        position: float = 0.0,
        velocity: float = 0.0,
        kp: float = 0.0,
        kd: float = 0.0,
        torque: float = 0.0,
        *,
        urgent: bool = False,
    ) -> None:
        """Send one set-point."""
        torque = self._rounding.next(velocity, kd, torque)
        data = self._command.encode(
            position=position, velocity=velocity, kp=kp, kd=kd, torque=torque
        )
        self.count_query()
        self.send(self.node, data, urgent=urgent, lifetime=None if urgent else FAST)

    def query(self) -> None:
        """Send a set-point without gains or torque: the drive responds, on or off."""
        self.impede()

    def stop_frames(self) -> Sequence[StopFrame]:
        """Damp as in a quick stop: a drive that is off ignores it."""
        kd = self._gains.brake
        data = self._command.encode(kd=kd, torque=self._rounding.single(0.0, kd, 0.0))
        return (StopFrame(self.node, data),)

    async def _switch(self, code: int, what: str, *, on: bool) -> None:
        answers = self._answers
        self._on = on
        await self.until(
            lambda: self._answers > answers and self.status.enabled is on,
            what,
            again=lambda: self._special(code),
            faults=on,
        )

    async def enable(self) -> None:
        """Enter motor mode with zero gains."""
        try:
            await self._switch(_ENABLE, "enabled", on=True)
        except BaseException:
            self._on = False
            raise

    async def disable(self) -> None:
        """Leave motor mode."""
        await self._switch(_DISABLE, "disabled", on=False)

    async def clear_faults(self) -> None:
        """Leave motor mode: the protocol has no fault reset, and a drive in fault is off."""
        self._on = False
        await self.until(
            lambda: not self.status.faults and not self.status.enabled,
            "free of faults",
            again=lambda: self._special(self.clearing),
            faults=False,
        )

    clearing = _DISABLE

    async def set_zero(self) -> None:
        """Set the current position as zero."""
        await self.until_zero(lambda: self._special(_ZERO))


_AK_FAULTS = {
    1: "over-temperature of the motor",
    2: "over-current",
    3: "over-voltage",
    4: "under-voltage",
    5: "encoder",
    6: "over-temperature of the drive",
    7: "locked rotor",
}


def fault_of(code: int, names: dict[int, str]) -> tuple[Fault, ...]:
    """Return the fault of a code."""
    text = names.get(code, f"fault {code}")
    return (Fault(text.replace(" ", "_"), text, code),)


class TMotorDrive(MitDrive):
    """A T-Motor AK in MIT mode, which also reports temperature and a fault."""

    extra = (Span("temperature", 8), Span("fault", 8))

    def _more(self, identifier: int, **values: float) -> None:
        self.status.motor_temperature = values["temperature"] - 40.0
        code = int(values["fault"])
        self.status.faults = fault_of(code, _AK_FAULTS) if code else ()
        if code:
            self._on = self.status.enabled = False


MIT = Profile(
    "mit",
    "MIT mini-cheetah actuators.",
    MitOptions,
    MitDrive,
    "rcp_can.sim.mit:MitTwin",
    range(1, 128),
    family="mit",
)
TMOTOR = Profile(
    "tmotor",
    "T-Motor AK actuators in MIT mode.",
    MitOptions,
    TMotorDrive,
    "rcp_can.sim.mit:TMotorTwin",
    range(1, 128),
    family="mit",
)
