"""Robots that do as a test wants when they are stopped: at rest, late, out of reach, or moving again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import msgspec
from playwright.async_api import Browser

from browser.watched import Watched, signed_in
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceTimeout
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, MotionState, Progress
from rcp_kernel.types import Twist

__all__ = ["Mover", "Movers", "key_of", "movers", "person"]

PEOPLE: dict[str, dict[str, Any]] = {
    "ada": {"role": "admin"},
    "otto": {"role": "operator"},
    "local": {"role": "local", "tenants": ["alpha", "beta"]},
    "half": {"roles": {"alpha": "lead", "beta": "operator"}},
}
_CONFIG = listener() + table("plugins.dashboard")
_SAFETY = (
    table("safety", groups={"cell": ["/tenant/alpha", "/tenant/beta/left"]})
    + role("local", rule("*", "/**", "/system/**"), stop_all=False)
    + role("lead", rule("*", "/**", "/system/**"), reset=True)
)
ROBOTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "near": ("alpha", ()),
    "far": ("gamma", ()),
    "pair": ("beta", ("left", "right")),
}
"""Tenants, and the robots that a backend fronts if there are several."""


class Parts(msgspec.Struct):
    """The robots of a backend."""

    parts: tuple[str, ...] = ()


class Mover(ScriptedRobot):
    """Moves as fast as it is told to, and rests when it is halted, if it obeys."""

    def __init__(self, host: Host, parts: tuple[str, ...]) -> None:
        super().__init__(host)
        self.names: tuple[str | None, ...] = parts or (None,)
        self.speeds: dict[str | None, float] = dict.fromkeys(self.names, 0.0)
        self.driven = asyncio.Event()
        """Set by a write that moves it."""
        self.holds = 0
        for part in self.names:
            at = "" if part is None else f"{part}/"
            twist = Resource(
                name=f"actuator/{at}cmd_vel",
                description="Drives.",
                value=Twist,
                safe=Twist(),
                valid_for=0.5,
                robot=part,
            )
            going = Resource(name=f"action/{at}go", description="Goes on and on.", robot=part)
            self.add(twist, going)
            self.takes[twist.name] = partial(self._drive, part)
            self.behaviours[going.name] = partial(self._go, part)
            self.tell(part)

    def tell(self, part: str | None, speed: float | None = None) -> None:
        """Have it move, whoever does that."""
        if speed is not None:
            self.speeds[part] = speed
        at = "" if part is None else f"{part}/"
        speeds = msgspec.structs.replace(Twist().linear, x=self.speeds[part])
        self.host.publish(f"actuator/{at}cmd_vel", Twist(linear=speeds))

    async def _drive(self, part: str | None, value: Twist) -> None:
        self.tell(part, value.linear.x)
        if value.linear.x:
            self.driven.set()

    async def _go(self, part: str | None, value: Any, progress: Progress) -> Any:
        self.tell(part, 0.4)
        return await self.wait(value, progress)

    async def halt(self) -> None:
        for part in self.names:
            await self.halt_robot(part)

    async def halt_robot(self, robot: str | None) -> None:
        await self.reach()
        self._brake(robot)
        if self.speeds[robot]:
            raise DeviceTimeout(f"moves at {self.speeds[robot]:g} m/s")

    def _brake(self, part: str | None) -> None:
        if self.obeys:
            self.speeds[part] = 0.0

    async def hold(self, robot: str | None) -> None:
        self.holds += 1
        await self.halt_robot(robot)

    def hold_stop(self, robot: str | None) -> None:
        if not self.lost:
            for part in self.names if robot is None else (robot,):
                self._brake(part)

    def motion(self, robot: str | None) -> MotionState:
        if self.lost:
            return MotionState(None, self.lost)
        speed = max(self.speeds.values()) if robot is None else self.speeds[robot]
        return MotionState(not speed, f"moves at {speed:g} m/s" if speed else "")


class Movers:
    """Where the gateway is, and its robots by the names of their backends."""

    def __init__(self) -> None:
        self.url = ""
        self.by: dict[str, Mover] = {}


def key_of(name: str) -> str:
    """Return the key of a person."""
    return f"key-of-{name}-which-is-long"


@asynccontextmanager
async def movers(many: int = 0) -> AsyncGenerator[Movers]:
    """Run the gateway while entered; with `many` there are so many robots, and no others."""
    made = Movers()
    there = asyncio.Event()
    named: dict[tuple[str, tuple[str, ...], str | None], str] = {}
    robots = {f"robot-{at:03}": (f"t{at % 4}", ()) for at in range(many)} if many else ROBOTS

    @asynccontextmanager
    async def opened(config: Parts, host: Host) -> AsyncGenerator[Mover]:
        mover = Mover(host, config.parts)
        # A backend is not told its own name.
        made.by[named.pop((host.tenant, config.parts, host.robot))] = mover
        if not named:
            there.set()
        yield mover

    text = _CONFIG if many else _CONFIG + _SAFETY
    for name, (tenant, parts) in robots.items():
        place = {"robot": name} if many else {}
        text += backend(name, tenant, use="mover", parts=parts, **place)
        named[(tenant, parts, place.get("robot"))] = name
    people = {"ada": PEOPLE["ada"]} if many else PEOPLE
    text += "".join(key(name, key_of(name), **held) for name, held in people.items())
    recent = configure("error", "json")
    kind = BackendKind("mover", Parts, opened)
    async with serve(parse(text, "test"), kind, recent=recent) as served:
        made.url = next(f["url"] for f in served.server.status.transports if "url" in f)
        async with asyncio.timeout(60):
            await there.wait()
        yield made


@asynccontextmanager
async def person(
    browser: Browser, gateway: Movers, name: str, page: str = "", script: str = ""
) -> AsyncGenerator[Watched]:
    """Be somebody at a page of the gateway."""
    async with signed_in(browser, gateway.url, key_of(name), name, script) as tab:
        await tab.open(page)
        yield tab
