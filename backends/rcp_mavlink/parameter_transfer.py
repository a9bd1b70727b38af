"""All parameters at once: written to a file, compared with one, loaded from one, reset."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable
from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    PreconditionFailed,
)
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.described import Described
from rcp_mavlink.paramcoding import stored
from rcp_mavlink.parameter_files import FORMATS, Entry, Fault, Row, checked, is_state, parsed
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.reversal import reversed_on_failure
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ParameterTransfer"]

_STORAGE, _RESET = 245, 2.0  # PREFLIGHT_STORAGE and its first parameter
_REFUSED = "Take this parameter out of the file, or set the one that it depends on first."
_SHOWN = 3  # faults in the message
_TOLD = 100  # faults in the details
_LEFT = 20  # names in the message
_UNANSWERED = 3  # time-outs in a row after which nothing more is put back
_EXAMPLE = {"text": "RTL_ALT,2000\nWPNAV_SPEED,500\n"}

Text = Annotated[str, Meta(max_length=1 << 20, extra_json_schema={"format": "multiline"})]
Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]
Number = Annotated[float, Meta(extra_json_schema={"unit": "1"})]


class ExportFormat(Struct, frozen=True, forbid_unknown_fields=True):
    """The kind of file."""

    format: Literal["param", "params"] = "param"
    """`param` of Mission Planner and MAVProxy, `params` of QGroundControl."""


class ParameterFile(Struct, frozen=True):
    """A file with all parameters."""

    text: str
    count: Count


class GivenFile(Struct, frozen=True, forbid_unknown_fields=True):
    """A file of either kind."""

    text: Text


class LoadFile(GivenFile, frozen=True, forbid_unknown_fields=True):
    """A file of either kind, and what is done with parameters that the vehicle does not have."""

    skip_unknown: bool = False
    """Skip them; otherwise the file is refused."""


class Difference(Struct, frozen=True):
    """A parameter whose value in the file is not that of the vehicle."""

    name: str
    vehicle: Number
    file: Number


class Comparison(Struct, frozen=True):
    """How a file differs from the vehicle."""

    differences: list[Difference]
    same: Count
    unknown: list[str]
    """Those of the file that the vehicle does not have."""
    absent: Count
    """How many of the vehicle's are not in the file."""


class LoadProgress(Struct, frozen=True):
    """The parameter that was just written."""

    name: str
    done: Count
    total: Count


class Loaded(Struct, frozen=True):
    """What a file has changed; each was read back."""

    written: list[Difference]
    """`vehicle` is the value before."""
    unchanged: Count
    skipped: list[str]
    """Those unknown, if wanted, and those that the vehicle itself keeps, such as its counters."""
    restart: list[str]
    """Those that take effect only after a reboot, if the metadata is known (`parameters`)."""


class ParameterTransfer:
    """The parameters of one vehicle as a whole."""

    def __init__(
        self,
        vehicle: Vehicle,
        parameters: Parameters,
        commands: Commands,
        described: Described,
        reboot: Callable[[], Awaitable[None]],
        check: Callable[[Iterable[str]], None],
    ) -> None:
        self._vehicle, self._parameters, self._commands = vehicle, parameters, commands
        self._described, self._reboot = described, reboot
        self._check = check
        """Called with the names of parameters before they are written; raises to refuse them."""

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/param/export", meta=READS, description="Write all parameters to a file.", input=ExportFormat | None, output=ParameterFile, examples=(None, {"format": "params"}), timeout=120),
            Resource(name="service/param/compare", meta=READS, description="Compare a parameter file with the vehicle.", input=GivenFile, output=Comparison, examples=(_EXAMPLE,), timeout=120),
            Resource(name="action/param/load", moves=False, description="Write the values of a parameter file that differ, and read them back; if one is refused, all are put back. The vehicle must be disarmed.", input=LoadFile, output=Loaded, feedback=LoadProgress, examples=(_EXAMPLE,), timeout=1800, max_age=30.0),
            Resource(name="action/param/reset", description="Reset all parameters to the firmware's defaults, and reboot. The vehicle must be disarmed.", output=ParameterFile, timeout=300, max_age=30.0),
        ]  # fmt: skip

    async def export(self, given: ExportFormat | None, _: Progress) -> ParameterFile:
        """Write them to a file, in the order of their names.

        :raises DeviceTimeout: the vehicle does not send all of them.
        """
        await self._known()
        return self._file((given or ExportFormat()).format)

    def _file(self, form: str) -> ParameterFile:
        known = sorted(self._parameters.known.items())
        rows = [Row(name, each.value, each.type) for name, each in known]
        text = FORMATS[form](rows, self._vehicle.system, self._vehicle.component)
        return ParameterFile(text, len(rows))

    async def compare(self, given: GivenFile, _: Progress) -> Comparison:
        """Compare a file with the vehicle.

        :raises InvalidValue: lines of the file are no parameters.
        """
        await self._known()
        entries, faults = await asyncio.to_thread(parsed, given.text)
        _refuse(faults)
        known = self._parameters.known
        there = [entry for entry in entries if entry.name in known]
        wrong = {fault.line for fault in checked(there, self._types())}
        changes = [e for e in there if e.line in wrong or self._differs(e)]
        return Comparison(
            [Difference(e.name, known[e.name].value, e.value) for e in changes],
            len(there) - len(changes),
            [entry.name for entry in entries if entry.name not in known],
            len(known) - len(there),
        )

    async def load(self, given: LoadFile, progress: Progress) -> Loaded:
        """Write what differs, and read it back; put all back if one is refused or on a cancel.

        :raises InvalidValue: lines of the file are no parameters of this vehicle; nothing is written.
        :raises PreconditionFailed: it is armed.
        :raises EstopActive: it is stopped, and some of them may move it; nothing is written.
        :raises DeviceRejected: it refuses a value, does not respond, or is armed meanwhile.
        """
        self._check_disarmed("load")
        await self._known()
        entries, faults = await asyncio.to_thread(parsed, given.text)
        known = self._parameters.known
        unknown = {e.name for e in entries if given.skip_unknown and e.name not in known}
        skipped = [e.name for e in entries if e.name in unknown or is_state(e.name)]
        left_out = set(skipped)
        entries = [entry for entry in entries if entry.name not in left_out]
        faults += checked(entries, self._types())
        _refuse(faults)
        changes = [entry for entry in entries if self._differs(entry)]
        self._check(entry.name for entry in changes)
        before = [Difference(e.name, known[e.name].value, e.value) for e in changes]
        written: list[Difference] = []
        async with reversed_on_failure(lambda: self._put_back(written), _REFUSED):
            for change in before:
                if self._vehicle.armed:
                    raise DeviceRejected("param/load: the vehicle was armed meanwhile")
                written.append(change)
                progress(
                    LoadProgress(change.name, len(written), len(before)),
                    fraction=len(written) / (len(before) + 1),
                )
                await self._write(change)
            for change in before:
                await self._verify(change)
        published = await self._described.load()
        late = [c.name for c in before if c.name in published and published[c.name].restart]
        return Loaded(before, len(entries) - len(before), skipped, late)

    async def reset(self, _: None, progress: Progress) -> ParameterFile:
        """Reset them to the firmware's defaults, reboot, and list them anew.

        :raises PreconditionFailed: it is armed.
        :raises DeviceTimeout: it does not come back, or does not send all of them.
        """
        self._check_disarmed("reset")
        await self._commands.send(Command(_STORAGE, (_RESET, 0.0, 0.0, 0.0)), "reset parameters")
        progress(fraction=0.1)
        await self._reboot()
        progress(fraction=0.5)
        self._parameters.forget()
        await self._known()
        return self._file("param")

    def _check_disarmed(self, what: str) -> None:
        if self._vehicle.armed:
            raise PreconditionFailed(
                f"param/{what}: the vehicle is armed", remedy="Disarm it first."
            )

    async def _known(self) -> None:
        if not self._parameters.complete.is_set():
            await self._parameters.list()
        if not self._parameters.complete.is_set():
            there, count = len(self._parameters.known), self._parameters.count
            raise DeviceTimeout(f"the vehicle has sent {there} of {count or 'its'} parameters")

    def _types(self) -> dict[str, int]:
        return {name: known.type for name, known in self._parameters.known.items()}

    def _differs(self, entry: Entry) -> bool:
        return self._kept(entry.name, entry.value) != self._parameters.known[entry.name].value

    def _kept(self, name: str, value: float) -> float:
        type_ = self._parameters.known[name].type
        return stored(value, type_, bytewise=self._vehicle.bytewise)

    async def _write(self, change: Difference) -> None:
        now = await self._parameters.write(change.name, change.file)
        self._check_kept(change, now)

    async def _verify(self, change: Difference) -> None:
        self._check_kept(change, await self._parameters.read(change.name))

    def _check_kept(self, change: Difference, now: float) -> None:
        if now != self._kept(change.name, change.file):
            raise DeviceRejected(f"the vehicle made {change.name} {now:g} of {change.file:g}")

    async def _put_back(self, written: list[Difference]) -> str:
        """Write the values of before, in reverse order; return what has come of it."""
        left: list[str] = []
        unanswered = 0
        for change in reversed(written):
            if unanswered == _UNANSWERED:
                left.append(change.name)
                continue
            try:
                self._check((change.name,))
                now = await self._parameters.write(change.name, change.vehicle)
            except Exception as error:  # the others are put back all the same
                unanswered = unanswered + 1 if isinstance(error, DeviceTimeout) else 0
                left.append(change.name)
                continue
            unanswered = 0
            if now != change.vehicle and not math.isnan(change.vehicle):
                left.append(f"{change.name} (it is {now:g}, and was {change.vehicle:g})")
        if left:
            more = f" and {len(left) - _LEFT} more" if len(left) > _LEFT else ""
            return f"these could not be put back: {', '.join(sorted(left)[:_LEFT])}{more}"
        return "every parameter has its value of before"


def _refuse(faults: list[Fault]) -> None:
    """Refuse a file as a whole.

    :raises InvalidValue: there are faults.
    """
    if not faults:
        return
    faults = sorted(faults)
    shown = "; ".join(f"line {fault.line}: {fault.reason}" for fault in faults[:_SHOWN])
    more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
    raise InvalidValue(
        shown + more,
        remedy="Mend these lines, or set skip_unknown for parameters that this vehicle lacks.",
        details={
            "pointer": "/text",
            "lines": [{"line": fault.line, "reason": fault.reason} for fault in faults[:_TOLD]],
        },
    )
