"""Commands lost with their link: the robot may still execute them, and the client is notified."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, RcpError
from rcp_kernel.tree.entry import Entry

if TYPE_CHECKING:
    from rcp_kernel.sessions.command import Command

__all__ = ["tell_cut_off", "tell_loss"]

_LOST = (AdapterUnavailable, DeviceTimeout)
_THEN = {
    "hold": "the gateway commands it to hold when the link is restored",
    "continue": "it may carry on: the gateway sends nothing when the link is restored",
    "land": "the gateway commands it to land when the link is restored",
    "return": "the gateway commands it to return home when the link is restored",
}


def tell_loss(entry: Entry, error: RcpError, began: int) -> None:
    """Record that a command was lost with the link, and add the loss policy to its error.

    `Backend.on_loss` is the policy for when contact returns. There is nothing to do for a command
    that began before a stop that has reached the robot; `began` is the number of stops before it.
    """
    if not entry.moves or not isinstance(error, _LOST):
        return
    if not entry.unit.loss.note(entry.path, began):
        return
    policy = entry.owner.on_loss
    error.details = {**(error.details or {}), "on_loss": policy}
    error.message = _with_policy(error.message, policy)


def tell_cut_off(command: Command, policy: str) -> None:
    """Do the same for a command interrupted by the end of an earlier gateway."""
    last = command.history[-1]
    if last.error is None:
        return
    message = _with_policy(last.error["message"], policy)
    details = {**last.error.get("details", {}), "on_loss": policy}
    error = {**last.error, "message": message, "details": details}
    command.history[-1] = replace(last, message=message, error=error)


def _with_policy(message: str, policy: str) -> str:
    return f"{message}; {_THEN.get(policy, policy)} (on_loss = {policy})"
