"""A twin in a process of its own, as somebody starts it who has nothing of the gateway."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager


class Process:
    """`python -m rcp_mavlink_sim`, and where it is reached."""

    def __init__(self, popen: subprocess.Popen[str], ports: dict[str, int]) -> None:
        self.popen = popen
        self.ports = ports


@contextmanager
def twin_process(*links: str, options: tuple[str, ...] = ()) -> Generator[Process]:
    """Run a twin while entered; the ports of its links by their kind."""
    command = [sys.executable, "-m", "rcp_mavlink_sim", *options]
    for link in links:
        command += ["--link", link]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as popen:
        assert popen.stdout is not None
        ports: dict[str, int] = {}
        for link in links:
            words = popen.stdout.readline().split()
            assert words, f"it did not start: {popen.wait(5)}"
            ports[link.partition(":")[0]] = int(words[-1].rpartition(":")[2])
        try:
            yield Process(popen, ports)
        finally:
            popen.terminate()
            popen.wait(10)
