"""Commands to payloads: servo, relay, gripper, winch, parachute."""

from __future__ import annotations

from collections.abc import Callable

from rcp_mavlink_sim.requests import CommandRequest, outcome
from rcp_mavlink_sim.wire import mav

__all__ = ["DOERS"]


def _servo(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.outputs.set_servo(c.p[0], c.p[1]))


def _relay(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.outputs.set_relay(c.p[0], c.p[1]))


def _gripper(c: CommandRequest) -> int:
    """Open or close the gripper; its number is not looked at (`AP_Gripper`)."""
    return outcome(c.peer.vehicle.payloads.grip(c.p[1]))


def _winch(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.payloads.wind(c.p[1], c.p[2], c.p[3]))


def _parachute(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.payloads.parachute(c.p[0]))


DOERS: dict[int, Callable[[CommandRequest], int]] = {
    mav.MAV_CMD_DO_SET_SERVO: _servo,
    mav.MAV_CMD_DO_SET_RELAY: _relay,
    mav.MAV_CMD_DO_GRIPPER: _gripper,
    mav.MAV_CMD_DO_WINCH: _winch,
    mav.MAV_CMD_DO_PARACHUTE: _parachute,
}
"""What each command does."""
