"""Hands a plan over to the next gateway's guard, so that an old guard does not stop its robots.

A guard whose gateway is gone listens on one socket per plan, named after the plan's content, so
only a guard with the same plan finds it. Linux only (abstract sockets): elsewhere an old guard
continues to its time limit.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
import struct
from typing import Any

__all__ = ["Heirs", "claim"]

_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid: unix(7)


class Heirs:
    """Waits for guards that have the same plans, and a running gateway."""

    def __init__(self, plans: dict[str, dict[str, Any]]) -> None:
        self._sockets: dict[str, socket.socket] = {}
        for name, plan in plans.items():
            with contextlib.suppress(OSError, AttributeError):
                listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                listener.setblocking(False)
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
                listener.bind(_address(plan))
                self._sockets[name] = listener

    def taken(self) -> list[str]:
        """Return the plans that another guard of the same user has taken over."""
        found = [name for name, listener in self._sockets.items() if _claimed(listener)]
        for name in found:
            self._sockets.pop(name).close()
        return found


def claim(plan: dict[str, Any]) -> None:
    """Tell an old guard, if there is one, that this guard has taken over a plan."""
    with (
        contextlib.suppress(OSError, AttributeError),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notifier,
    ):
        notifier.setblocking(False)
        notifier.sendto(b"mine", _address(plan))


def _claimed(listener: socket.socket) -> bool:
    claimed = False
    with contextlib.suppress(OSError):
        while True:
            _, ancillary, _, _ = listener.recvmsg(16, socket.CMSG_SPACE(_CREDENTIALS.size))
            for _, kind, data in ancillary:
                if kind == socket.SCM_CREDENTIALS and len(data) == _CREDENTIALS.size:
                    _, user, _ = _CREDENTIALS.unpack(data)
                    claimed = claimed or user in (os.getuid(), 0)
    return claimed


def _address(plan: dict[str, Any]) -> bytes:
    identity = json.dumps([plan.get("sender"), plan.get("data")], sort_keys=True)
    return b"\0rcp_guard/" + hashlib.sha256(identity.encode()).hexdigest().encode()
