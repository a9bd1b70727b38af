"""Procedures that dump, compare, load and store the settings of a drive, the same for every make."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.messages import Count
from rcp_can.procedure import Procedure
from rcp_can.settings import Line, Settings, check_range, read_text, refused, same, write_text
from rcp_kernel.errors import DeviceRejected, RcpError
from rcp_kernel.model import READS
from rcp_kernel.spi import Progress

__all__ = ["SettingsText", "settings_procedures"]

_TIMEOUT = 300.0  # s; some drives have hundreds
_STORING = 15.0  # s
_LONGEST = 200_000  # characters of a text
_LEFT = (
    "`written` in the details is in force and not stored: load what is left once the cause is "
    "removed, or switch the drive off and on, which brings its stored settings back."
)


class SettingsText(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings, all of a drive or some."""

    text: Annotated[str, Meta(max_length=_LONGEST)]
    """A line `name value` for each; lines that begin with `#` are comments."""


class SettingsDump(Struct, frozen=True, kw_only=True):
    """All settings of a drive."""

    text: str
    """A line `name value` for each."""
    settings: Count


class SettingDifference(Struct, frozen=True, kw_only=True):
    """A setting that is not as in the text."""

    name: str
    text: str
    drive: str


class SettingsComparison(Struct, frozen=True, kw_only=True):
    """How a drive differs from a text."""

    differences: list[SettingDifference]
    compared: Count
    unknown: list[str]
    """Names that the drive does not have."""


class SettingsLoaded(Struct, frozen=True, kw_only=True):
    """What was written, and read back as written; it is in force, and not stored yet."""

    written: list[str]
    unchanged: Count
    left_out: list[str]
    """Differing settings that are not written: ids, and what the gateway sets or the drive only tells."""


class SettingWritten(Struct, frozen=True, kw_only=True):
    """The setting that was written last, and read back."""

    name: str


def settings_procedures(settings: Settings) -> Sequence[Procedure]:
    """List the procedures for the settings of one drive."""
    seen: dict[str, str] = {}

    async def read(tell: Callable[[float], object]) -> dict[str, str]:
        await settings.prepare()
        found = await settings.read_all(tell)
        seen.update(found)
        return found

    def check(wanted: SettingsText) -> None:
        for line in read_text(wanted.text):
            if settings.known and line.name not in settings.known:
                raise _unknown(line)
            if line.name in seen and same(line.value, seen[line.name], settings.step):
                continue  # what a drive has already cannot be wrong
            if settings.setting(line.name).writable:
                check_range(line, settings.setting(line.name))

    async def dump(_value: None, progress: Progress) -> SettingsDump:
        found = await read(lambda part: progress(fraction=part))
        return SettingsDump(text=write_text(found), settings=len(found))

    async def compare(wanted: SettingsText, progress: Progress) -> SettingsComparison:
        lines = read_text(wanted.text)
        found = await read(lambda part: progress(fraction=part))
        return SettingsComparison(
            differences=[
                SettingDifference(name=line.name, text=line.value, drive=found[line.name])
                for line in lines
                if line.name in found and not same(line.value, found[line.name], settings.step)
            ],
            compared=sum(line.name in found for line in lines),
            unknown=[line.name for line in lines if line.name not in found],
        )

    async def load(wanted: SettingsText, progress: Progress) -> SettingsLoaded:
        lines = read_text(wanted.text)
        found = await read(lambda _part: None)
        for line in lines:
            if line.name not in found:
                raise _unknown(line)
        changed = [line for line in lines if not same(line.value, found[line.name], settings.step)]
        due = [line for line in changed if settings.setting(line.name).writable]
        for line in due:
            check_range(line, settings.setting(line.name))
        return SettingsLoaded(
            written=await _write(settings, due, progress),
            unchanged=len(lines) - len(changed),
            left_out=[line.name for line in changed if line not in due],
        )

    async def save(_value: None, _progress: Progress) -> None:
        await settings.prepare()
        try:
            await settings.save()
        except RcpError as error:
            _begun(error)
            raise

    example = {"text": f"# name value\n{_example(settings)}\n"}
    procedures = (
        Procedure(
            "dump_settings",
            "Read all its settings as text.",
            dump,
            needs="connected",
            output=SettingsDump,
            timeout=_TIMEOUT,
            meta=READS,
        ),
        Procedure(
            "compare_settings",
            "Compare its settings with a text.",
            compare,
            needs="connected",
            input=SettingsText,
            output=SettingsComparison,
            examples=(example,),
            timeout=_TIMEOUT,
            meta=READS,
        ),
        Procedure(
            "load_settings",
            "Write what differs from a text, each read back; nothing if a line is wrong. Not stored"
            + (", see save_settings." if settings.saves else ": a loss of supply ends it."),
            load,
            needs="disabled",
            input=SettingsText,
            output=SettingsLoaded,
            feedback=SettingWritten,
            examples=(example,),
            timeout=_TIMEOUT,
            check=check,
        ),
    )
    if not settings.saves:
        return procedures
    return (
        *procedures,
        Procedure(
            "save_settings",
            "Store its settings, so that they survive a loss of supply.",
            save,
            needs="disabled",
            timeout=_STORING,
        ),
    )


async def _write(settings: Settings, lines: list[Line], progress: Progress) -> list[str]:
    """Write lines one by one, and look at all again; an error tells which were written."""
    written: list[str] = []
    try:
        for line in lines:
            await settings.write(line.name, line.value)
            _check_kept(line, await settings.read(line.name), settings.step)
            written.append(line.name)
            progress(SettingWritten(name=line.name), fraction=len(written) / len(lines))
        if len(lines) > 1:  # a drive that rebooted meanwhile has forgotten the first ones
            found = await settings.read_all(lambda _part: None)
            written = [
                line.name
                for line in lines
                if same(line.value, found.get(line.name, ""), settings.step)
            ]
            for line in lines:
                _check_kept(line, found.get(line.name, "nothing"), settings.step)
    except RcpError as error:
        _begun(error)
        error.details = {**(error.details or {}), "written": written}
        error.remedy = _LEFT
        raise
    return written


def _begun(error: RcpError) -> RcpError:
    """Return an error of what may have been written by then, which is no refusal."""
    error.status = "failed" if error.status == "rejected" else error.status
    return error


def _check_kept(line: Line, found: str, step: float) -> None:
    if not same(line.value, found, step):
        raise DeviceRejected(
            f"line {line.number}: the drive kept {line.name} {found} instead of {line.value}",
            details={"pointer": "/text", "line": line.number},
        )


def _unknown(line: Line) -> RcpError:
    return refused(line.number, f"the drive has no setting '{line.name}'")


def _example(settings: Settings) -> str:
    """Return a line that would be taken."""
    for name, each in settings.known.items():
        if each.writable and each.low >= 0:
            return f"{name} {min(max(each.low, 1.0), each.high):g}"
    return "servo.max_current_A 10"
