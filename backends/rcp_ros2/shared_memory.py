"""Ports of Fast DDS in shared memory that a killed process left half made.

Whoever opens such a port waits for ever for its maker, with the interpreter's lock held: no other
robot of the gateway could be stopped. Port 7000 belongs to the processes of all domains.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import structlog

from rcp_kernel.errors import NotReady

__all__ = ["remove_half_made"]

log = structlog.get_logger("rcp.ros2")
_FOLDER = Path("/dev/shm")  # noqa: S108 - where POSIX shared memory is
_PREFIXES = ("fastdds_port", "fastrtps_port")
"""Of Fast DDS 3, and of the versions before it."""
_MADE = (2).to_bytes(4, "little"), (3).to_bytes(4, "little")
"""First bytes of a segment of Boost that is ready, or known to be corrupt: nobody waits for those."""
_MAKING = 2.0  # s that a living process may take to make a port: it takes less than a millisecond
_PAUSE = 0.05  # s


def remove_half_made(folder: Path = _FOLDER) -> None:
    """Remove ports that are not finished in time; blocks, so called in a worker thread.

    This harms nobody, in whatever container it runs: nobody can use a port that is not ready, and
    Fast DDS makes another one. What a process left locked when it was killed, Fast DDS frees by
    itself within two seconds.

    :raises NotReady: such a port belongs to another user.
    """
    end = time.monotonic() + _MAKING
    while found := list(_half_made(folder)):
        if time.monotonic() >= end:
            for port in found:
                _remove(port)
            return
        time.sleep(_PAUSE)


def _half_made(folder: Path) -> Iterator[Path]:
    for prefix in _PREFIXES:
        for port in folder.glob(f"{prefix}*"):
            if port.name.removeprefix(prefix).isdigit() and not _is_made(port):
                yield port


def _is_made(port: Path) -> bool:
    if not os.access(port, os.R_OK | os.W_OK):  # Fast DDS cannot open it, and takes the next port
        return True
    with contextlib.suppress(FileNotFoundError), port.open("rb") as file:
        return file.read(4) in _MADE
    return True


def _remove(port: Path) -> None:
    try:
        port.unlink(missing_ok=True)
    except PermissionError as error:
        raise NotReady(
            f"{port} was left half made by a killed ROS process, and ROS 2 would wait for it for ever: "
            f"remove that file as its owner (sudo rm {port})"
        ) from error
    log.warning(
        "ros_shared_memory_removed",
        file=str(port),
        detail="a killed ROS process left it half made, and ROS 2 would have waited for it for ever",
        remedy="Restart ROS nodes that hang since.",
    )
