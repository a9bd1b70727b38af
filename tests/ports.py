"""Ports that a test needs to know before anybody listens on them."""

from __future__ import annotations

import os
import socket

__all__ = ["free_port"]

_PORTS = range(20_000, 30_000)
"""None that the system gives to a socket by itself, meanwhile or while a gateway is away."""


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Return a port of this machine that nobody has, and that no other test takes, of this run or of another.

    It is claimed by the name of a socket, which goes with this process, however it ends.
    """
    first = os.getpid() % len(_PORTS)  # what another run has just left may still linger
    for port in (*_PORTS[first:], *_PORTS[:first]):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0rcp-gateway-tests-port-{port}")
            with socket.socket(socket.AF_INET, kind) as tried:
                tried.bind(("127.0.0.1", port))
        except OSError:
            claim.close()
        else:
            claim.detach()
            return port
    raise AssertionError("every port is in use")
