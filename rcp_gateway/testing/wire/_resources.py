"""The resources of the wire suite's robot: one for each kind of requirement."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import DeviceTimeout
from rcp_kernel.model import Operation, Resource
from rcp_kernel.types import Int64, PoseStamped, Twist, UInt64, nonfinite, quantity

__all__ = ["BROKEN", "Frame", "Go", "Parcel", "arrived", "ghost", "resources", "small"]


_SETTINGS = "settings"  # what is written as one


class Battery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A pack."""

    voltage: quantity("V")  # pyright: ignore[reportInvalidTypeForm] - a type made at run time
    charge: quantity("1", ge=0, le=1) = 1.0  # pyright: ignore[reportInvalidTypeForm]


class Parcel(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One of everything that encodings differ in."""

    i64: Int64 = 0
    u64: UInt64 = 0
    real: nonfinite("m") = 0.0  # pyright: ignore[reportInvalidTypeForm]
    finite: quantity("m") = 0.0  # pyright: ignore[reportInvalidTypeForm]
    text: str = ""
    data: bytes = b""
    flag: bool = False
    items: list[nonfinite("1")] = msgspec.field(default_factory=list)  # pyright: ignore[reportInvalidTypeForm, reportUnknownVariableType]
    table: dict[str, Int64] = {}
    nothing: None = None


class Go(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Distance, and events to inject on the way."""

    distance: quantity("m", ge=-100, le=100)  # pyright: ignore[reportInvalidTypeForm]
    mode: Literal["quick", "wait", "refuse", "stumble", "timeout", "crash"] = "quick"


class Frame:
    """A value in a serialised form of the robot's own: one byte for each decimetre."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def decode(self) -> Any:
        """Return the level in metres."""
        return len(self.data) / 10


BROKEN: dict[str, Exception] = {
    "sensor/late": DeviceTimeout("the probe did not answer"),
    "sensor/cut": ConnectionResetError("the cable was pulled"),
    "sensor/crashed": ZeroDivisionError("a secret of the backend's code"),
}
"""Values that cannot be read, and their substitutes."""


def small() -> list[Resource]:
    """Return a level and a limit."""
    return [
        Resource(
            name="sensor/level",
            description="The water level in the tank.",
            value=quantity("m"),
            live=True,
            deadline=0.3,
            history=64,
            examples=(1.5,),
            profiles=("acme.tank/1.2",),
        ),
        Resource(
            name="param/limit",
            description="The highest speed.",
            value=quantity("m/s", ge=0, le=2.5),
            examples=(1.0,),
            atomic=_SETTINGS,
        ),
    ]


def ghost() -> list[Resource]:
    """Return the resources of a robot that is not available."""
    go = Resource(name="action/go", description="Would go.", input=Go)
    return [*small(), go]


def arrived() -> list[Resource]:
    """Return the resources it declares additionally once it is available."""
    level = quantity("m")
    return [
        Resource(name="sensor/arrived", description="Comes with the robot.", value=level, live=True)
    ]


def _values() -> list[Resource]:
    level = quantity("m")
    return [
        Resource(name="sensor/lazy", description="Comes while watched.", value=level),
        Resource(name="sensor/asked", description="Has to be asked for.", value=level),
        Resource(name="sensor/silent", description="Never answers.", value=level),
        Resource(name="sensor/pose", description="Where it is.", value=PoseStamped, live=True),
        Resource(name="sensor/battery", description="The pack.", value=Battery, live=True),
        Resource(name="sensor/parcel", description="Of everything.", value=Parcel, live=True),
        Resource(name="sensor/secret", description="Hidden from some.", value=level, live=True),
        Resource(
            name="sensor/frame",
            description="Comes in the robot's own form.",
            value=level,
            live=True,
            native="wire/Frame",
        ),
        *(Resource(name=n, description="Breaks.", value=level) for n in BROKEN),
        Resource(
            name="param/label", description="A name.", value=Annotated[str, Meta(max_length=20)]
        ),
        Resource(name="param/parcel", description="Of everything.", value=Parcel),
        Resource(
            name="param/fixed",
            description="Cannot be changed.",
            value=quantity("1", int),
            operations=Operation.READ,
        ),
        Resource(name="param/refused", description="Is locked.", value=level, atomic=_SETTINGS),
        Resource(name="param/slow", description="Takes its time.", value=level),
        Resource(name="param/cut", description="Is cut off at 1.", value=level, atomic=_SETTINGS),
        Resource(name="event/note", description="Something happened.", value=str, live=True),
        Resource(
            name="actuator/drive",
            description="A velocity.",
            value=Twist,
            valid_for=0.2,
            safe=Twist(),
            max_age=1.0,
            examples=({"linear": {"x": 0.5}},),
        ),
    ]


def _calls() -> list[Resource]:
    metres = quantity("m")
    go: dict[str, Any] = {"input": Go, "output": metres, "feedback": metres}
    return [
        Resource(name="action/go", description="Go ahead.", examples=({"distance": 1.0},), **go),
        Resource(
            name="action/line", description="Stand in line.", policy="queue", max_age=10, **go
        ),
        Resource(name="action/dash", description="Push in.", policy="preempt", **go),
        Resource(name="action/beside", description="Go side by side.", policy="parallel", **go),
        Resource(name="action/tied", description="End with its client.", outlives=False, **go),
        Resource(name="action/short", description="Has little time.", timeout=0.1, **go),
        Resource(name="service/echo", description="Say it again.", input=Parcel, output=Parcel),
        Resource(name="service/nothing", description="Do nothing."),
        Resource(name="service/liar", description="Answer wrong.", output=metres),
    ]


def resources() -> list[Resource]:
    """Return everything."""
    return [*small(), *_values(), *_calls()]
