"""Two machines of a gateway in this process, which do nothing but keep what they were told to do."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.process.log import configure
from rcp_kernel.spi import BackendKind, BaseBackend, Host, Progress
from rcp_kernel.testing import serve
from rcp_kernel.types import Int64, Point, Pose, PoseStamped, quantity
from rcp_kernel.values import to_plain

__all__ = ["Machines", "key_of", "machines"]

PEOPLE = {"ada": "admin", "otto": "operator", "lena": "learner"}
_CONFIG = """
[transports.asgi]
port = 0
[plugins.dashboard]
[safety]
approval_ttl = {ttl}
[[backends]]
use = "machine"
name = "one"
tenant = "alpha"
[[backends]]
use = "machine"
name = "two"
tenant = "beta"
[roles.learner]
allow = [{{ operations = ["*"], paths = ["/**", "/system/commands", "/system/plans", "/system/status"] }}]
approve = ["/action/**", "/param/**"]
"""
_DEGREES = Annotated[float, Meta(ge=-180, le=180)]


class Fix(msgspec.Struct, frozen=True):
    """A place on Earth."""

    latitude: _DEGREES
    longitude: _DEGREES


class MoveTo(msgspec.Struct, frozen=True):
    """Where to go, and with which heading."""

    position: Point
    yaw: quantity("rad") | None = None  # pyright: ignore[reportInvalidTypeForm]
    words: str = ""


class Nothing(msgspec.Struct):
    """There is nothing to configure."""


class Machine(BaseBackend):
    """Tells where it is, and takes whatever it is told."""

    def __init__(self, host: Host, got: list[tuple[str, Any]]) -> None:
        self.host = host
        self._got = got
        self._serial = 0

    def declare(self) -> None:
        """Put its resources into the tree, with where it is."""
        self.host.declare(
            Resource(name="sensor/pose", description="Where.", value=PoseStamped, live=True),
            Resource(name="sensor/fix", description="Where on Earth.", value=Fix, live=True),
            Resource(name="param/serial", description="A long number.", value=Int64),
            Resource(name="action/move_to", description="Goes.", input=MoveTo),
            Resource(name="action/go_to", description="Goes on Earth.", input=Fix),
            Resource(name="service/step", description="Steps once.", input=Pose | None),
        )
        self.host.publish("sensor/pose", PoseStamped(Point(0, 0)))
        self.host.publish("sensor/fix", Fix(47.5, 8.5))

    async def read(self, name: str) -> Any:
        return self._serial if name == "param/serial" else await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        self._serial = value
        self._got.append((name, value))

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        self._got.append((name, to_plain(value)))


@dataclass
class Machines:
    """Where the gateway is, and what its machines were told so far, in that order."""

    url: str = ""
    one: list[tuple[str, Any]] = field(default_factory=list)
    two: list[tuple[str, Any]] = field(default_factory=list)

    def forget(self) -> None:
        """Begin anew."""
        self.one.clear()
        self.two.clear()


def key_of(name: str) -> str:
    """Return the key of a person."""
    return f"key-of-{name}-which-is-long"


@asynccontextmanager
async def machines(ttl: float = 300) -> AsyncGenerator[Machines]:
    """Run the gateway while entered; `ttl` in seconds is how long an approval stands."""
    made = Machines()

    @asynccontextmanager
    async def opened(_: Nothing, host: Host) -> AsyncGenerator[Machine]:
        machine = Machine(host, made.one if host.tenant == "alpha" else made.two)
        machine.declare()
        yield machine

    keys = "".join(
        f'[[keys]]\nname = "{name}"\nrole = "{role}"\nkey = "{key_of(name)}"\n'
        for name, role in PEOPLE.items()
    )
    configure("error", "json")
    config = parse(_CONFIG.format(ttl=ttl) + keys, "test")
    async with serve(config, BackendKind("machine", Nothing, opened)) as served:
        made.url = next(f["url"] for f in served.server.status.transports if "url" in f)
        yield made
