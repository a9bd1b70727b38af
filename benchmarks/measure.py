"""Run a server on core 0 and a load on core 1; take what the server's CPU did for it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import psutil

SECONDS = 1.5
ROUNDS = 3


def measured(script: str, server: str, *load: str) -> dict[str, float]:
    """Run `script serve <server>` and `script load <port> …`; the load prints a JSON object.

    The server prints its port. The load prints a line when it is connected, then `done` messages
    counted over its time.
    """
    with subprocess.Popen(
        [sys.executable, script, "serve", server],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        psutil.Process(process.pid).cpu_affinity([0])
        assert process.stdout
        port = process.stdout.readline().decode().strip()
        client = subprocess.Popen(
            [sys.executable, script, "load", port, server, *load], stdout=subprocess.PIPE
        )
        psutil.Process(client.pid).cpu_affinity([1])
        line_of(client)
        before, begun = cpu_of(process.pid), time.perf_counter()
        result = json.loads(line_of(client))
        cpu, ended = cpu_of(process.pid) - before, time.perf_counter()
        client.wait()
        process.kill()
    return {**result, "cpu": cpu, "busy": cpu / (ended - begun), "per_cpu": result["done"] / cpu}


def cpu_of(pid: int) -> float:
    """Return the seconds that the threads of a process have run; its times count in steps of 10 ms."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / 1e9


def line_of(load: subprocess.Popen[bytes]) -> bytes:
    """Read a line of the load; one that has ended has said why."""
    assert load.stdout
    line = load.stdout.readline()
    if not line:
        sys.exit(f"the load ended with {load.wait()}, and nothing was measured")
    return line


def best(script: str, *servers: tuple[str, ...]) -> list[dict[str, float]]:
    """Measure several servers in turns, for the machine's mood changes; the best of each."""
    rounds = [[measured(script, *server) for server in servers] for _ in range(ROUNDS)]
    return [max(found, key=lambda one: one["per_cpu"]) for found in zip(*rounds, strict=True)]


def row(name: str, found: dict[str, float], base: dict[str, float] | None = None) -> None:
    """Print one line of a table."""
    ratio = f"  {found['per_cpu'] / base['per_cpu']:5.2f} x" if base else ""
    print(f"  {name:34} {found['per_cpu'] / 1000:9.1f} k/CPU-s  cpu {found['busy']:5.0%}{ratio}")
