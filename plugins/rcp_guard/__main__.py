"""Run as `python -m rcp_guard --fd N`, by the gateway."""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import socket

from rcp_guard.guard import Guard

_PRIORITY = -10  # niceness, where permitted


def main() -> None:
    """Guard the gateway at the other end of the socket."""
    parser = argparse.ArgumentParser(prog="rcp_guard", description=__doc__)
    parser.add_argument("--fd", type=int, required=True, help="socket to the gateway")
    parser.add_argument("--after", type=float, default=0.5, help="seconds without a heartbeat")
    parser.add_argument("--bound", type=float, default=10.0, help="seconds that stops are sent")
    arguments = parser.parse_args()
    with contextlib.suppress(OSError):
        os.nice(_PRIORITY)
    guard = Guard(socket.socket(fileno=arguments.fd), after=arguments.after, bound=arguments.bound)
    # A service manager signals all processes of a service: only the gateway's own end counts.
    for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT", "SIGABRT", "SIGTSTP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), guard.end)
    gc.freeze()
    guard.run()
    # Middleware threads that do not end must not keep the process alive.
    os._exit(0)


if __name__ == "__main__":
    main()
