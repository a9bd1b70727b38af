"""CPU time of the gateway for one GET of each kind of route: those of Litestar beside a value, which goes straight.

Run: python benchmarks/http_routes.py [TREE…]. Each tree serves with its own code, in turns; the first
is this one, unless others are named. One client asks, one request after the other.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

ROUTES = {
    "value": "/rcp/v1/context/tenant/t/sensor/pose",
    "health": "/healthz",
    "status": "/rcp/v1/status",
    "discovery": "/rcp/v1/discovery?limit=10",
    "schemas": "/rcp/v1/schemas",
    "commands": "/rcp/v1/commands?limit=10",
    "unknown command": "/rcp/v1/commands/none",
    "dashboard values": "/dashboard/api/latest?path=/tenant/t/**",
    "dashboard page": "/",
}
KEY = "operator-of-the-benchmark"
CONFIG = f"""
[plugins.dashboard]
[tenants.t]
[[keys]]
name = "bench"
role = "operator"
key = "{KEY}"
"""
WARM, COUNT, ROUNDS = 300, 2000, 3
SOURCES = ("", "transports", "plugins", "backends", "clients/python", "benchmarks")


def serve() -> None:
    from served import serve_gateway

    serve_gateway(more=CONFIG)


class Server:
    """The gateway of a tree."""

    def __init__(self, tree: Path) -> None:
        places = os.pathsep.join(str(tree / source) for source in SOURCES)
        self._process = subprocess.Popen(
            [sys.executable, __file__, "serve"],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": places, "PYTHONSAFEPATH": "1"},
        )
        assert self._process.stdout
        self._peer = socket.create_connection(
            ("127.0.0.1", int(self._process.stdout.readline().strip()))
        )

    def each(self, path: str) -> float:
        """Return the µs of CPU that one request takes."""
        request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {KEY}\r\n\r\n".encode()
        self._ask(request, WARM)
        before = self._spent()
        self._ask(request, COUNT)
        return (self._spent() - before) / COUNT / 1000

    def _spent(self) -> int:
        """Return the CPU time of the thread with the event loop, in ns: no tick is that fine."""
        return int(Path(f"/proc/{self._process.pid}/schedstat").read_text().split()[0])

    def _ask(self, request: bytes, count: int) -> None:
        for _ in range(count):
            self._peer.sendall(request)
            data = b""
            while b"\r\n\r\n" not in data:
                data += self._peer.recv(1 << 20)
            head, _, body = data.partition(b"\r\n\r\n")
            missing = int(head.lower().partition(b"content-length: ")[2].split()[0]) - len(body)
            while missing > 0:
                missing -= len(self._peer.recv(1 << 20))

    def end(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()


def main() -> None:
    trees = [Path(name).resolve() for name in sys.argv[1:]] or [Path(__file__).parents[1]]
    servers = [Server(tree) for tree in trees]
    for name, path in ROUTES.items():
        rounds = [[server.each(path) for server in servers] for _ in range(ROUNDS)]
        best = [min(found) for found in zip(*rounds, strict=True)]
        beside = f"   {best[0] / best[1]:5.2f} x" if len(best) > 1 else ""
        print(f"  {name:18}" + "".join(f"{one:9.0f} µs" for one in best) + beside, flush=True)
    for server in servers:
        server.end()


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve()
    else:
        main()
