"""The options of a subscription: the body of `subscribe`."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_conditions.filters import MAX_TERMS, Deadband, fields_of
from rcp_kernel.errors import FilterUnsupported, InvalidValue
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import Encoding, ValueType

__all__ = ["Options", "Qos", "check_fields", "seconds"]

_MAX_DEPTH = 65_536
_AGES = 3.2e9  # s: a century is long enough


class Qos(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Quality of service of one subscription."""

    reliability: Literal["best_effort", "reliable"] = "best_effort"
    depth: Annotated[int, Meta(ge=1, le=_MAX_DEPTH)] | None = None
    """Samples queued per path; default 1 for best effort and 1024 for reliable."""
    priority: Annotated[int, Meta(ge=0, le=7)] = 4
    """0…7; 7 is sent first."""
    deadline: Annotated[float, Meta(gt=0)] | None = None
    """Seconds without an update after which the client gets a notice."""
    lifespan: Annotated[float, Meta(gt=0)] | None = None
    """Seconds after which a sample is too old to be delivered."""


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The body of `subscribe`: all fields are optional, and filters are combined with AND."""

    paths: tuple[str, ...] = ()
    rate: Annotated[float, Meta(gt=0, le=10_000)] | None = None
    on: Literal["sample", "change"] = "sample"
    deadband: Deadband | None = None
    where: dict[str, Any] | None = None
    fields: tuple[Annotated[str, Meta(min_length=1, max_length=256)], ...] | None = None
    history: Annotated[int, Meta(ge=0, le=_MAX_DEPTH)] | str | None = None
    initial: bool = True
    qos: Qos = Qos()
    encoding: Literal["json", "cbor", "msgpack", "native"] | None = None
    duration: Annotated[float, Meta(gt=0)] | None = None
    count: Annotated[int, Meta(ge=1)] | None = None
    frame: Annotated[str, Meta(min_length=1, max_length=64)] | None = None

    def __post_init__(self) -> None:
        # Each one costs time for every sample, on the event loop that also handles e-stops.
        several = {"fields": self.fields, "deadband": self.deadband}
        for name, given in several.items():
            if isinstance(given, (tuple, dict)) and len(given) > MAX_TERMS:
                text = f"`{name}` has {len(given)} fields; the limit is {MAX_TERMS}"
                raise ValueError(text)
        if self.frame is not None and self.encoding == "native":
            text = "native bytes are not converted to another `frame`"
            raise ValueError(text)

    @property
    def plain(self) -> bool:
        """Whether every sample passes unchanged."""
        return (
            self.rate is None
            and self.on == "sample"
            and self.deadband is None
            and self.where is None
            and self.qos.lifespan is None
        )

    @property
    def depth(self) -> int:
        """The queue's length; by default that of the reliability."""
        return self.qos.depth or (1024 if self.qos.reliability == "reliable" else 1)

    @property
    def splice(self) -> Encoding | None:
        """The requested encoding; None for the connection's own or `native`."""
        return None if self.encoding in (None, "native") else Encoding(self.encoding)


def seconds(text: str) -> float:
    """Parse a duration such as `"30s"`, `"500ms"`, `"2m"` or `"1h"`.

    :raises InvalidValue: it is not one.
    """
    for unit, factor in (("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0)):
        number = text.removesuffix(unit)
        if number != text:
            try:
                value = float(number) * factor
            except ValueError:
                break
            if math.isfinite(value) and value >= 0:
                return min(value, _AGES)
            break
    raise InvalidValue(f"{text[:40]!r} is not a duration", remedy='Use "30s", "500ms" or "2m".')


def check_fields(options: Options, entry: Entry, type_: ValueType) -> None:
    """Check that the type of the values to be sent has everything that the options name.

    :raises FilterUnsupported: it lacks a field or the native encoding.
    """
    named = list(options.fields or ())
    if options.where is not None:
        named += fields_of(options.where)
    if isinstance(options.deadband, dict):
        named += options.deadband
    for field in named:
        if field and not type_.has_field(field):
            raise FilterUnsupported(
                f"{entry.path} has no field '{field}'",
                path=entry.path,
                remedy="Use a field of its schema; `discover` returns the schema.",
            )
    if options.encoding == "native" and entry.resource.native is None:
        raise FilterUnsupported(
            f"{entry.path} has no native encoding",
            path=entry.path,
            remedy="Use json, cbor or msgpack.",
        )
