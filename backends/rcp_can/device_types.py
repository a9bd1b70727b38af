"""The value type of a CAN message, from the signals in its DBC file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

__all__ = ["message_type"]

_UCUM = {"": "1", "degC": "Cel", "°C": "Cel", "Nm": "N.m", "rpm": "/min", "deg": "deg", "-": "1"}


def message_type(message: Message, *, bounded: bool) -> type[msgspec.Struct]:
    """Create the Struct of a message: one field per signal, with its unit.

    `bounded` rejects values beyond the signal's range, for messages that are sent; received values
    are published as they are. A signal that only some variants of a multiplexed message have is
    optional.
    """
    fields: list[tuple[str, Any, Any]] = []
    needed: list[tuple[str, Any]] = []
    for signal in message.signals:
        type_ = _type(signal, bounded=bounded)
        if signal.multiplexer_ids:
            fields.append((signal.name, type_ | None, None))
        else:
            needed.append((signal.name, type_))
    return msgspec.defstruct(
        message.name,
        [*needed, *fields],
        frozen=True,
        forbid_unknown_fields=True,
        kw_only=True,
    )


def _type(signal: Signal, *, bounded: bool) -> Any:
    whole = not signal.is_float and float(signal.scale).is_integer()
    whole = whole and float(signal.offset).is_integer()
    unit = signal.unit or ""
    extra: Any = {"unit": _UCUM.get(unit, unit)}
    bounds: dict[str, Any] = {}
    if bounded:
        low, high = signal.minimum, signal.maximum
        bounds = {
            key: int(limit) if whole else float(limit)
            for key, limit in (("ge", low), ("le", high))
            if limit is not None
        }
    return Annotated[int if whole else float, Meta(**bounds, extra_json_schema=extra)]
