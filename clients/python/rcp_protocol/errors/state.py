"""State errors: the robot, a command or the gateway cannot do this now."""

from __future__ import annotations

from typing import Any

from rcp_protocol.errors.base import Failed, Refused

__all__ = [
    "AdapterUnavailable",
    "AlreadyRunning",
    "DeadlineExceeded",
    "DeviceRejected",
    "DeviceTimeout",
    "EstopActive",
    "Gap",
    "ModeForbids",
    "Overrun",
    "PreconditionFailed",
    "QueueFull",
    "StaleCommand",
]


class EstopActive(Refused):
    """An emergency stop is latched."""

    code = "estop_active"
    http = 423
    default_remedy = (
        "Make sure the robot is safe, then ask someone whose role has `reset = true` to reset "
        "the e-stop."
    )


class ModeForbids(Refused):
    """The robot's mode does not allow this now."""

    code = "mode_forbids"
    http = 409
    default_remedy = "Switch the robot to a mode that allows it."


class PreconditionFailed(Refused):
    """A condition on other resources is false or unknown."""

    code = "precondition_failed"
    http = 409
    default_remedy = "Make the condition in the message true, then send it again."


class StaleCommand(Refused):
    """The command is older than its path allows."""

    code = "stale_command"
    http = 409
    default_remedy = "Send a new command with the current time; check that the clocks agree."


class AlreadyRunning(Refused):
    """The action is already running and its policy is `reject`."""

    code = "already_running"
    http = 409
    retryable = True
    default_remedy = "Wait for the running command to end, or cancel it."


class QueueFull(Refused):
    """A bounded queue is full; retry after `retry_after` seconds."""

    code = "queue_full"
    http = 503
    retryable = True
    default_remedy = "Wait for earlier requests to finish, then send it again."

    def __init__(self, message: str, *, retry_after: float = 1.0, **more: Any) -> None:
        super().__init__(message, retry_after=retry_after, **more)


class Gap(Refused):
    """The missed data is no longer in the replay buffer."""

    code = "gap"
    http = 410
    default_remedy = "Subscribe again, and read the current values."


class AdapterUnavailable(Refused):
    """The backend or adapter behind the path is not connected."""

    code = "adapter_unavailable"
    http = 503
    retryable = True
    default_remedy = (
        "Check that the robot is switched on and reachable; /system/status lists the backends."
    )


class DeviceRejected(Failed):
    """The robot refused; the message carries its reason."""

    code = "device_rejected"
    http = 502
    default_remedy = "Fix the cause that the robot reports, then send it again."


class DeviceTimeout(Failed, TimeoutError):
    """The robot did not answer in time."""

    code = "device_timeout"
    http = 504
    retryable = True
    default_remedy = "Check the robot and its link; check its state before you send it again."


class DeadlineExceeded(Failed, TimeoutError):
    """The deadline passed before the reply was ready."""

    code = "deadline_exceeded"
    http = 504
    retryable = True
    default_remedy = "Check the state of the robot, then send it again with a longer `deadline`."


class Overrun(Failed):
    """A reliable subscription fell behind further than its queue allows."""

    code = "overrun"
    http = 503
    default_remedy = "Subscribe again with a lower `rate`, a larger `depth`, or `best_effort`."
