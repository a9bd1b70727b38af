"""A real gateway in a process of its own around a cart that a datagram drives; told what to do by lines.

Run as `python gateway.py '{"plan": …, "port": …, "more": "…"}'`. Each line of stdin is a JSON object
with `do`; each line of stdout is a fact. It ends with its stdin, unless it is frozen: then after five minutes.
"""

from __future__ import annotations

import asyncio
import ctypes
import json
import os
import re
import signal
import socket
import sys
import time
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager, suppress
from types import SimpleNamespace
from typing import Any

import msgspec
import psutil
import uvloop

import rcp_guard_link
from configuration import backend, configuration, key
from rcp_gateway.features import active
from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, Server, running
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress, StopPlan, Watchdog
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding

CONFIG = configuration(backend(use="cart"), key("admin", "admin-admin-admin"))


class NoOptions(msgspec.Struct):
    """The cart has nothing to configure."""


class Cart(BaseBackend):
    """Drives a device that never stops by itself."""

    def __init__(self, host: Host, port: int) -> None:
        self._to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to.connect(("127.0.0.1", port))
        self.velocity = 0.0
        self.hang_after = ""
        self.confirms = asyncio.Event()
        """Set while it confirms that it was brought to rest."""
        self.confirms.set()
        host.declare(
            Resource(
                name="actuator/velocity",
                description="A velocity.",
                value=quantity("m/s"),
                safe=0.0,
                valid_for=60.0,
            ),
            Resource(name="action/go", description="Goes on for ever.", policy="parallel"),
            Resource(name="service/hang", description="Hangs.", input=str, moves=False),
            Resource(name="param/label", description="A label.", value=str),
        )

    def drive(self, velocity: float) -> None:
        self.velocity = velocity
        self._to.send(b"v %g" % velocity)
        if self.hang_after:
            self._hang(*self.hang_after.split())

    async def write(self, name: str, value: Any) -> Any:
        if name == "actuator/velocity":
            self.drive(value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if name == "service/hang":
            self._hang(*value.split())
            return
        self.drive(0.5)
        await asyncio.Event().wait()

    def _hang(self, how: str, seconds: str) -> None:
        tell(frozen=how, at=time.monotonic())
        if how == "gil":
            ctypes.PyDLL(None).usleep(int(float(seconds) * 1e6))
        elif how == "regex":
            re.match(r"(a+)+$", "a" * 60 + "b")
        else:
            until = time.monotonic() + float(seconds)
            while True:
                if time.monotonic() > until:
                    return

    def motion(self, robot: str | None) -> MotionState | None:
        return MotionState(at_rest=self.velocity == 0.0)

    async def halt(self) -> None:
        self.drive(0.0)
        await self.confirms.wait()

    def watchdogs(self) -> list[Watchdog]:
        return [Watchdog("none: it goes on as it was told", None)]


def tell(**fact: Any) -> None:
    os.write(1, json.dumps(fact).encode() + b"\n")


def prepared(asked: dict[str, Any], carts: list[Cart]) -> Prepared:
    @asynccontextmanager
    async def open_cart(_config: NoOptions, host: Host) -> AsyncGenerator[Cart]:
        cart = Cart(host, asked["port"])
        carts.append(cart)
        if asked.get("plan"):
            host.guard("stop", msgspec.convert(asked["plan"], StopPlan))
        yield cart

    plugins: Any = SimpleNamespace(
        backends={"cart": BackendKind("cart", NoOptions, open_cart)},
        transports={},
        adapters={},
        missing=[],
        points={"plugins": {}},
        is_missing=lambda _group, _name: None,
    )
    config = parse(CONFIG + asked.get("more", ""), "test")
    kinds = {kind.name: kind for kind in rcp_guard_link.rcp_features()}
    features = active(config, kinds, "test")
    return Prepared(config, plugins, (NoOptions(),), {}, {}, features)


class Client:
    """Does what the lines of stdin say."""

    def __init__(self, server: Server, carts: list[Cart]) -> None:
        self._server, self._carts = server, carts
        principal = server.client_api.authenticate("admin-admin-admin")
        self._connection = server.client_api.connect(principal, Encoding.JSON, self._flush)

    def _flush(self) -> None:
        for data in self._connection.outbox.collect():
            reply = json.loads(data)
            tell(
                reply=reply["type"],
                path=reply.get("path"),
                status=reply["status"],
                error=reply.get("error"),
            )

    def _send(self, type_: str, path: str, body: Any = None) -> None:
        envelope = {"type": type_, "id": path, "path": path}
        if body is not None:
            envelope["body"] = body
        self._connection.receive(json.dumps(envelope).encode())

    def do(self, asked: dict[str, Any]) -> bool:
        """Do one thing; tell whether to go on."""
        match asked:
            case {"do": "drive", "velocity": velocity}:
                self._send("write", "/tenant/alpha/actuator/velocity", velocity)
            case {"do": "drive_and_hang"}:
                self._carts[-1].hang_after = "loop 3"
                self._send("write", "/tenant/alpha/actuator/velocity", 1.0)
            case {"do": "label"}:
                self._send("write", "/tenant/alpha/param/label", "crate")
            case {"do": "go"}:
                self._send("execute", "/tenant/alpha/action/go")
            case {"do": "estop"}:
                self._send("execute", "/system/estop", {})
            case {"do": "hang", "how": how}:
                self._send("execute", "/tenant/alpha/service/hang", how)
            case {"do": "confirm", "on": on}:
                confirms = self._carts[-1].confirms
                (confirms.set if on else confirms.clear)()
            case {"do": "guard"}:
                self._tell_guard()
            case _:
                return False
        return True

    def _tell_guard(self) -> None:
        kernel = self._server.gateway
        report = kernel.status.plain()
        text = _finished(kernel.exposition.write(self._connection.session.rights)).decode()
        tell(
            guard=report["guard"],
            pid=_guard_pid(),
            warnings=[record["message"] for record in report["warnings"]],
            metrics=re.findall(r"^(rcp_(?:guard|event).*) (\S+)$", text, re.MULTILINE),
        )


def _guard_pid() -> int | None:
    """Return the guard process of this gateway."""
    for child in psutil.Process().children():
        with suppress(psutil.Error):  # it has just ended
            if "rcp_guard" in child.cmdline():
                return child.pid
    return None


def _finished(work: Generator[None, None, bytes]) -> bytes:
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


async def main(asked: dict[str, Any]) -> None:
    carts: list[Cart] = []
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
    )
    async with running(prepared(asked, carts), configure("warning", "json")) as server:
        client = Client(server, carts)
        tell(ready=os.getpid())
        while (line := await reader.readline()) and client.do(json.loads(line)):
            pass
    tell(closed=True)


if __name__ == "__main__":
    signal.alarm(300)
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main(json.loads(sys.argv[1])))
