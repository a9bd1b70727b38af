"""How long `rcpd demo` takes until it answers, from the command to the first pose over HTTP.

Run: python benchmarks/startup.py
"""

from __future__ import annotations

import http.client
import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path

RUNS = 9


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def once() -> float:
    port = free_port()
    rcpd = Path(sys.executable).with_name("rcpd")
    started = time.perf_counter()
    with subprocess.Popen(
        [rcpd, "demo", "--port", str(port)], stdout=subprocess.DEVNULL
    ) as process:
        while True:
            try:
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=1)
                connection.request("GET", "/rcp/v1/context/tenant/alpha/sensor/pose")
                if connection.getresponse().status == 200:
                    took = time.perf_counter() - started
                    process.terminate()
                    return took
            except OSError:
                time.sleep(0.002)


times = sorted(once() for _ in range(RUNS))
print(
    f"rcpd demo answers after {statistics.median(times):.2f} s (min {times[0]:.2f}, max {times[-1]:.2f})"
)
