"""A gateway with the Foxglove protocol on a real port, around a robot that does as a test says."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec

from configuration import backend, key, listener, role, rule, table
from rcp_foxglove import rcp_adapters
from rcp_gateway.testing import ScriptedRobot
from rcp_gateway.testing._serve import Served, serve
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import NativeType, Operation, Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import PoseStamped, Twist, quantity

OPERATOR = "operator-of-these-tests"
WATCHER = "watcher-of-these-tests"
ADMIN = "admin-of-these-tests"


class NoOptions(msgspec.Struct):
    """There is nothing to configure."""


class Picture(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An image as a file."""

    width: int
    height: int
    data: bytes
    format: str = "png"
    frame_id: str = "camera"


class Serialised:
    """Counts how often bytes are decoded."""

    decoded = 0

    def __init__(self, data: bytes) -> None:
        self.data = data

    def decode(self) -> Any:
        type(self).decoded += 1
        return struct.unpack("<4xd", self.data)[0]


def _drive(data: bytes) -> Any:
    return {"linear": {"x": struct.unpack("<4xd", data)[0]}}


RANGE = NativeType(
    name="pkg/msg/Range",
    encoding="cdr",
    schema_encoding="ros2msg",
    schema="float64 range",
)
TWIST = NativeType(
    name="pkg/msg/Drive",
    encoding="cdr",
    schema_encoding="ros2msg",
    schema="float64 x",
    decode=_drive,
)
RESOURCES = (
    Resource(name="sensor/level", description="How full it is.", value=quantity("m"), live=True),
    Resource(name="sensor/pose", description="Where it is.", value=PoseStamped, live=True),
    Resource(name="sensor/camera", description="A view.", value=Picture, live=True),
    Resource(name="sensor/map", description="Bytes.", value=bytes, live=True),
    Resource(name="sensor/secret", description="Top secret.", value=str, live=True),
    Resource(
        name="sensor/range",
        description="A distance.",
        value=quantity("m"),
        live=True,
        native="pkg/msg/Range",
        native_types={"value": RANGE},
        meta={"topic": "/range", "type": "pkg/msg/Range"},
    ),
    Resource(name="param/limit", description="A limit.", value=quantity("m/s", ge=0, le=2.5)),
    Resource(
        name="param/model",
        description="What it is.",
        value=str,
        operations=Operation.READ | Operation.SUBSCRIBE,
    ),
    Resource(
        name="actuator/cmd_vel",
        description="Drives.",
        value=Twist,
        valid_for=0.5,
        safe=Twist(),
        native_types={"value": TWIST},
        meta={"topic": "/cmd_vel"},
    ),
    Resource(name="actuator/arm/cmd_vel", description="Jogs.", value=Twist, safe=Twist()),
    Resource(name="actuator/screen", description="Shows a text.", value=str),
    Resource(name="service/double", description="Doubles.", input=int, output=int),
    Resource(name="service/refuse", description="Refuses."),
    Resource(name="action/go", description="Goes.", input=quantity("m"), output=quantity("m")),
)


class Robot(ScriptedRobot):
    """A robot with something of each kind."""

    def __init__(self, host: Host) -> None:
        super().__init__(host, *RESOURCES)
        self.behaviours |= {"service/double": double, "service/refuse": refuse}
        self.measure("sensor/level", 1.25)
        self.measure("sensor/secret", "the hidden word")
        self.measure("param/limit", 1.0)
        self.measure("param/model", "rover")


async def double(value: Any, progress: Progress) -> Any:
    return value * 2


async def refuse(value: Any, progress: Progress) -> Any:
    raise DeviceRejected("the lid is open", remedy="Close the lid.")


class Site:
    """The gateway and its robot."""

    def __init__(self, served: Served, robots: list[Robot]) -> None:
        self.served = served
        self.server = served.server
        self.robots = robots
        self.base: str = next(f["url"] for f in self.server.status.transports if "url" in f)
        self.url = self.base + "/foxglove"

    @property
    def robot(self) -> Robot:
        return self.robots[0]


@asynccontextmanager
async def site(
    *,
    port: int = 0,
    own_port: int | None = None,
    more: str = "",
    kinds: tuple[BackendKind, ...] = (),
    clock: Clock = SYSTEM_CLOCK,
    **options: Any,
) -> AsyncGenerator[Site]:
    """Run a gateway; the options are those of the adapter."""
    if own_port is not None:
        options["port"] = own_port
    made: list[Robot] = []
    opened = asyncio.Event()

    @asynccontextmanager
    async def open_robot(_config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
        made.append(Robot(host))
        opened.set()
        yield made[-1]

    text = (
        "anonymous = false\n"
        + listener(port)
        + backend("robot")
        + table("plugins.foxglove", **options)
        + role("watcher", rule("discover read subscribe", "/sensor/level", "/param/limit"))
        + key("operator", OPERATOR, tenants=["alpha"])
        + key("watcher", WATCHER, tenants=["alpha"])
        + key("admin", ADMIN)
        + more
    )
    kind = BackendKind("robot", NoOptions, open_robot)
    config = parse(text, "test")
    async with serve(config, kind, *kinds, adapters=tuple(rcp_adapters()), clock=clock) as served:
        await asyncio.wait_for(opened.wait(), 60)
        yield Site(served, made)
