"""The gateway beside foxglove-sdk: fan-out, latency at a paced 50 Hz, large payloads.

Each server runs alone on one core, its clients on the other; figures are per CPU-second of the
server, taken by the operating system's own account. Run: python benchmarks/beside_foxglove.py
(pip install foxglove-sdk picows)
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import psutil
from measure import line_of

HERE = Path(__file__).parent / "servers"
SECONDS = 4.0


def run(server: str, kind: str, rate: float, burst: int, size: int, clients: int) -> dict:
    """Run one server with one producer and its clients; return what arrived and what it cost."""
    command = [sys.executable, str(HERE / server), str(rate), str(burst), str(size)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        process_info = psutil.Process(process.pid)
        process_info.cpu_affinity([0])
        assert process.stdout
        port = process.stdout.readline().decode().strip()
        path = "/sensor/blob" if size else "/sensor/pose"
        client = subprocess.Popen(
            [sys.executable, str(HERE / "client.py"), kind, port, str(clients), str(SECONDS), path],
            stdout=subprocess.PIPE,
        )
        psutil.Process(client.pid).cpu_affinity([1])
        line_of(client)
        before = process_info.cpu_times()
        result = json.loads(line_of(client))
        after = process_info.cpu_times()
        client.wait()
        process.terminate()
    cpu = after.user + after.system - before.user - before.system
    return {
        **result,
        "cpu": cpu,
        "per_cpu": result["frames"] / cpu,
        "bytes_cpu": result["bytes"] / cpu,
    }


def beside(title: str, rate: float, burst: int, size: int, clients: int) -> None:
    ours = run("gateway.py", "rcp", rate, burst, size, clients)
    theirs = run("foxglove_sdk.py", "foxglove", rate, burst, size, clients)
    print(f"{title}")
    for name, r in (("gateway", ours), ("foxglove-sdk", theirs)):
        offered = rate * clients * r["seconds"]
        print(
            f"  {name:13} {r['per_cpu'] / 1000:9.1f} k/CPU-s {r['bytes_cpu'] / 1e9:6.2f} GB/CPU-s "
            f"delivered {r['frames'] / offered:6.1%}  cpu {r['cpu'] / r['seconds']:5.1%}  "
            f"p50 {r['p50_ms']:7.2f} ms  p99 {r['p99_ms']:7.2f} ms"
        )
    print(f"  ratio per CPU-second {ours['per_cpu'] / theirs['per_cpu']:.2f}")


if __name__ == "__main__":
    beside("fan-out of 300 B to 10, 32 000/s in bursts of 16", 32_000, 16, 0, 10)
    beside("fan-out of 300 B to 100, 3 200/s in bursts of 16", 3200, 16, 0, 100)
    beside("one client, paced 100 Hz", 100, 1, 0, 1)
    beside("fan-out of 300 B to 100, paced 50 Hz", 50, 1, 0, 100)
    beside("1 MB payloads to 4", 100, 1, 1_000_000, 4)
