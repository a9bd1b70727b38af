"""The published values of a motor."""

from __future__ import annotations

from rcp_can import motor_messages as m
from rcp_can.axis_state import AxisState

__all__ = ["health", "motion", "state"]


def motion(axis: AxisState) -> m.Motion:
    """Return the last measurements at the joint, without stale ones."""
    status = axis.status
    return m.Motion(
        position=axis.position if axis.is_fresh("position") else None,
        velocity=axis.velocity if axis.is_fresh("velocity") else None,
        torque=None if status.torque is None else status.torque * axis.ratio,
        current=None if status.current is None else status.current * axis.config.direction,
    )


def health(axis: AxisState) -> m.Health:
    """Return temperatures and supply."""
    status = axis.status
    return m.Health(
        drive_temperature=status.drive_temperature,
        motor_temperature=status.motor_temperature,
        voltage=status.voltage,
    )


def state(axis: AxisState) -> m.MotorState:
    """Return the state of the motor."""
    return m.MotorState(
        state=axis.state,
        mode=axis.mode,
        faults=sorted(axis.faults.active),
        reached=axis.status.reached,
        homed=axis.status.homed,
        energised=axis.status.energised,
        watchdog=axis.drive.protection.within,
        watchdog_verified=axis.drive.protection.verified,
    )
