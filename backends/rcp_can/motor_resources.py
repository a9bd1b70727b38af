"""The resources of a motor."""

from __future__ import annotations

from collections.abc import Container
from typing import TYPE_CHECKING, Any

from rcp_can import motor_messages as m
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity

if TYPE_CHECKING:
    from rcp_can.axis import Axis

__all__ = ["motor_resources"]

_MOVE = 120.0  # s, the longest that a move may take
_SERVICE = 5.0  # s, the longest that a service may take


def motor_resources(axis: Axis, shared: Container[str] = ()) -> list[Resource]:
    """List the resources of one motor, depending on its drive."""
    name, config = axis.name, axis.config
    meta = {"profile": config.profile, "bus": config.bus, "node": config.node}
    return [
        Resource(
            name=f"sensor/{name}/motion",
            description=f"Position, velocity, torque and current of motor '{name}', at the joint.",
            value=m.Motion,
            live=True,
            deadline=config.timeout,
            meta=meta,
        ),
        Resource(
            name=f"sensor/{name}/state",
            description=f"State of motor '{name}': enabled or not, control mode, faults.",
            value=m.MotorState,
            live=True,
            meta=meta,
        ),
        Resource(
            name=f"sensor/{name}/health",
            description=f"Temperatures and supply voltage of motor '{name}', if it reports them.",
            value=m.Health,
            live=True,
            deadline=3.0,
            meta=meta,
        ),
        Resource(
            name=f"event/{name}/fault",
            description=f"A fault of motor '{name}', its link or its configuration appeared or cleared.",
            value=m.MotorFault,
            live=True,
        ),
        *_set_points(axis, shared),
        *_services(axis),
    ]


def _set_points(axis: Axis, shared: Container[str]) -> list[Resource]:
    name, valid_for = axis.name, axis.config.valid_for
    found: list[Resource] = []

    def offer(mode: str, unit: str, low: float, high: float, **more: Any) -> None:
        found.append(
            Resource(
                name=f"actuator/{name}/{mode}",
                description=f"Commanded {mode} of motor '{name}', at the joint.",
                value=quantity(unit, ge=low, le=high),
                examples=(_between(low, high, 0.55), _between(low, high, 0.6)),
                max_age=1.0,
                atomic=f"{mode} at {axis.config.rate:g} Hz" if mode in shared else None,
                meta={"profile": axis.config.profile},
                **more,
            )
        )

    modes = axis.drive.modes
    if "position" in modes:
        offer("position", "rad", axis.low, axis.high)
    dead_man = {"valid_for": valid_for, "safe": 0.0}
    if "velocity" in modes:
        low, high = axis.velocities
        offer("velocity", "rad/s", low, high, **dead_man)
    if "torque" in modes:
        offer("torque", "N.m", -axis.torque_limit, axis.torque_limit, **dead_man)
    return found


def _between(low: float, high: float, part: float) -> float:
    low, high = max(low, -1.0), min(high, 1.0)
    return round(low + part * (high - low), 4)


def _services(axis: Axis) -> list[Resource]:
    name = axis.name
    found = [
        _service(name, "enable", "Switch the power stage on, without moving.", energises=True),
        _service(name, "disable", "Switch the power stage off."),
        _service(
            name, "clear_faults", "Clear its faults, if any; the power stage is not switched."
        ),
    ]
    if axis.drive.zeroes:
        found.append(_service(name, "set_zero", "Set the current position as zero."))
    if axis.drive.homes:
        found.append(
            Resource(
                name=f"action/{name}/home",
                description=f"Find the reference of motor '{name}'.",
                timeout=_MOVE,
                max_age=1.0,
            )
        )
    if "position" in axis.drive.modes:
        here = _between(axis.low, axis.high, 0.55)
        found.append(
            Resource(
                name=f"action/{name}/move_to",
                description=f"Move motor '{name}' to a position; completes when its drive reports that it is done.",
                input=m.Move,
                output=m.Moved,
                feedback=m.MoveFeedback,
                examples=({"position": here},),
                timeout=_MOVE,
                max_age=1.0,
            )
        )
    return found


def _service(motor: str, verb: str, text: str, *, energises: bool = False) -> Resource:
    return Resource(
        name=f"service/{motor}/{verb}",
        description=f"Motor '{motor}': {text}",
        timeout=_SERVICE,
        energises=energises,
    )
