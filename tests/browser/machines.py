"""Two machines of a gateway in this process, which do nothing but keep what they were told to do."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from playwright.async_api import Browser

from browser.watched import Watched, signed_in
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import Int64, Point, PoseStamped, Twist, quantity
from rcp_kernel.values import to_plain

__all__ = ["Machines", "key_of", "machines", "person"]

PEOPLE = {"ada": "admin", "otto": "operator", "lena": "learner", "gil": "guest"}
_CONFIG = (
    backend("one", use="machine")
    + backend("two", "beta", use="machine")
    + role(
        "learner",
        rule("*", "/**", "/system/commands", "/system/plans", "/system/status"),
        approve=["/action/**", "/param/**"],
    )
    + role("guest", rule("read subscribe", "/tenant/beta/**", "/system/status"))
)
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


class Wanted(msgspec.Struct, frozen=True):
    """A file of the description."""

    uri: str


class File(msgspec.Struct, frozen=True):
    """It."""

    data: bytes
    media_type: str = "application/octet-stream"


class Nothing(msgspec.Struct):
    """There is nothing to configure."""


RESOURCES = (
    Resource(name="sensor/pose", description="Where.", value=PoseStamped, live=True, deadline=1.0),
    Resource(name="sensor/fix", description="Where on Earth.", value=Fix, live=True),
    Resource(name="param/serial", description="A long number.", value=Int64),
    Resource(name="param/robot_description", description="Its looks.", value=str),
    Resource(name="actuator/cmd_vel", description="Drives.", value=Twist, safe=Twist()),
    Resource(name="action/move_to", description="Goes.", input=MoveTo),
    Resource(name="action/dock", description="Docks."),
    Resource(name="action/go_to", description="Goes on Earth.", input=Fix),
    Resource(name="service/assets/fetch", description="Gives files.", input=Wanted, output=File),
)


class Machine(ScriptedRobot):
    """Tells where it is, and takes whatever it is told."""

    def __init__(self, host: Host, got: list[tuple[str, Any]]) -> None:
        super().__init__(host, values={"param/serial": 0})
        self.files: dict[str, bytes] = {}
        """What its description names, by the ends of the addresses."""
        self.asked: asyncio.Queue[str] = asyncio.Queue()
        self.held = asyncio.Event()
        """Files are given while it is set."""
        self.held.set()
        self.fails = False
        """Whether it takes nothing for now."""
        self._got = got
        self.behaviours["service/assets/fetch"] = self._fetch
        for name in ("action/move_to", "action/dock", "action/go_to"):
            self.behaviours[name] = partial(self._go, name)

    def come(self, x: float = 0, z: float = 0) -> None:
        """Put its resources into the tree, with where it is."""
        self.add(*RESOURCES)
        self.host.publish("sensor/pose", PoseStamped(Point(x, 0, z)))
        self.host.publish("sensor/fix", Fix(47.5, 8.5))

    def go(self) -> None:
        """Take them away."""
        self.remove(*(one.name for one in RESOURCES))

    async def write(self, name: str, value: Any) -> Any:
        if self.fails:
            raise DeviceRejected("the motor is jammed")
        await super().write(name, value)
        self._got.append((name, value))

    async def _fetch(self, value: Wanted, _progress: Progress) -> File:
        self.asked.put_nowait(value.uri)
        await self.held.wait()
        return File(next(data for end, data in self.files.items() if value.uri.endswith(end)))

    async def _go(self, name: str, value: Any, progress: Progress) -> None:
        self._got.append((name, to_plain(value)))
        if isinstance(value, MoveTo) and value.words == "for ever":
            await self.wait(value, progress)


@dataclass
class Machines:
    """Where the gateway is, and what its machines were told so far, in that order."""

    url: str = ""
    one: list[tuple[str, Any]] = field(default_factory=list)
    two: list[tuple[str, Any]] = field(default_factory=list)
    by: dict[str, Machine] = field(default_factory=dict)
    """The machines, by their tenants."""

    def forget(self) -> None:
        """Begin anew."""
        self.one.clear()
        self.two.clear()


def key_of(name: str) -> str:
    """Return the key of a person."""
    return f"key-of-{name}-which-is-long"


@asynccontextmanager
async def machines(
    ttl: float = 300,
    port: int = 0,
    *,
    absent: bool = False,
    panels: Mapping[str, str] | None = None,
) -> AsyncGenerator[Machines]:
    """Run the gateway while entered; `ttl` in seconds is how long an approval stands.

    Machines that are `absent` come when they are told to. `panels` are those of plugins.
    """
    made = Machines()

    @asynccontextmanager
    async def opened(_: Nothing, host: Host) -> AsyncGenerator[Machine]:
        machine = Machine(host, made.one if host.tenant == "alpha" else made.two)
        made.by[host.tenant] = machine
        if not absent:
            machine.come()
        yield machine

    people = "".join(key(name, key_of(name), role=role) for name, role in PEOPLE.items())
    configure("error", "json")
    dashboard = table("plugins.dashboard", panels=dict(panels or {}))
    text = listener(port) + dashboard + table("safety", approval_ttl=ttl) + _CONFIG + people
    config = parse(text, "test")
    async with serve(config, BackendKind("machine", Nothing, opened)) as served:
        made.url = next(f["url"] for f in served.server.status.transports if "url" in f)
        yield made


@asynccontextmanager
async def person(
    browser: Browser, running: Machines, name: str, page: str
) -> AsyncGenerator[Watched]:
    """Be somebody at a page of the machines' gateway."""
    async with signed_in(browser, running.url, key_of(name), name) as tab:
        await tab.open(page)
        yield tab
