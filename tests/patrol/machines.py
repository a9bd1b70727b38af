"""Six mobile robots, each behind a gateway of its own, and where they really are."""

from __future__ import annotations

import importlib
import os
import warnings
from collections.abc import AsyncGenerator, Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, NamedTuple

import can
import msgspec
import pytest

import rcp_can
import rcp_mavlink
import rcp_mujoco
import rcp_sim
from backends.can.rig import channel
from backends.can.rover import rover_bench, tables, twins
from backends.mavlink.flying import speed
from backends.mavlink.flying import twin as vehicle_twin
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import Served, serve
from rcp_kernel.config.file import GatewayConfig, KeyConfig, decode_table
from rcp_kernel.spi import BackendKind

__all__ = ["ADMIN", "KEY", "MACHINES", "Machine", "Truth"]

KEY, ADMIN = "operator-of-the-patrol", "admin-of-the-patrol"


class Truth(NamedTuple):
    """Where a robot is, m, and whether it is at rest."""

    x: float
    y: float
    still: bool


class Machine(NamedTuple):
    """A robot, and the gateway in front of it."""

    url: str
    served: Served
    truth: Callable[[], Truth]
    near: float
    """m from a goal that it may be at the end."""
    side: float
    """m, of a square that it can patrol."""
    cut: Callable[[], object] | None = None
    """Cuts the link to the device."""


@asynccontextmanager
async def _gateway(
    kinds: Iterable[BackendKind], options: Mapping[str, Any]
) -> AsyncGenerator[tuple[Served, str]]:
    kind = next(iter(kinds))
    backend = {"use": kind.name, "name": kind.name, "tenant": "t", "options": dict(options)}
    transports = {"asgi": {"port": 0}, "ws": {}, "http": {}}
    raw = {"transports": transports, "backends": [backend], "store": {"path": None}}
    config = decode_table(raw, GatewayConfig, "test: ")
    keys = (
        KeyConfig(name="operator", role="operator", key=KEY),
        KeyConfig(name="admin", role="admin", key=ADMIN),
    )
    async with serve(msgspec.structs.replace(config, keys=keys), kind) as served:
        client = served.client(KEY)

        async def ready() -> bool:
            found = (await client.request("read", "/system/robots"))["body"]
            mobile = [one for one in found if _is_mobile(one)]
            return [one["state"] for one in mobile] == ["ready"]

        await eventually(ready, "it is ready", 30.0)
        yield served, next(f["url"] for f in served.server.status.transports if "url" in f)


def _is_mobile(facts: Mapping[str, Any]) -> bool:
    return any(name.startswith("mobile/") for name in facts.get("profiles", ()))


@asynccontextmanager
async def _simulated() -> AsyncGenerator[Machine]:
    async with _gateway(rcp_sim.rcp_backends(), {}) as (served, url):
        rover: Any = served.life.backend.device.sim.rover  # type: ignore[attr-defined]
        yield Machine(url, served, lambda: Truth(rover.x, rover.y, rover.at_rest), 0.2, 1.0)


@asynccontextmanager
async def _vehicle(kind: str, near: float) -> AsyncGenerator[Machine]:
    async with vehicle_twin(vehicle=kind, heading=-45.0, noise=0.0) as running:
        options = {"links": [f"udpout:127.0.0.1:{running.ports[0][1]}"], "feedback_timeout": 5.0}
        vehicle = running.vehicle
        vehicle.set_home(None)

        def truth() -> Truth:
            (north, east), body = vehicle.home_place(), vehicle.body
            still = speed(vehicle) < 0.35 if kind == "rover" else not vehicle.armed
            return Truth(body.e - east, body.n - north, still)

        def cut() -> None:
            running.muted = True

        async with _gateway(rcp_mavlink.rcp_backends(), options) as (served, url):
            seen = served.life.backend.robots[""]  # type: ignore[attr-defined]
            await seen.parameters.complete.wait()
            yield Machine(url, served, truth, near, 6.0, cut)


@asynccontextmanager
async def _physics() -> AsyncGenerator[Machine]:
    options = {"model": "rover", "cameras": False}
    async with _gateway(rcp_mujoco.rcp_backends(), options) as (served, url):
        simulation: Any = served.life.backend.device.robot.simulation  # type: ignore[attr-defined]

        def truth() -> Truth:
            x, y = simulation.data.qpos[:2].tolist()
            return Truth(x, y, bool((abs(simulation.data.qvel[:6]) < 0.05).all()))

        yield Machine(url, served, truth, 0.2, 1.0)


@asynccontextmanager
async def _wheels() -> AsyncGenerator[Machine]:
    name = channel()
    with rover_bench(can.Bus(name, "virtual", ignore_config=True)) as bench:

        def truth() -> Truth:
            real = twins(bench)[2]
            return Truth(real.x, real.y, real.still())

        def cut() -> None:
            for wheel in bench.twins:
                wheel.silent = True

        async with _gateway(rcp_can.rcp_backends(), tables(name)) as (served, url):
            yield Machine(url, served, truth, 0.2, 1.0, cut)


@asynccontextmanager
async def _ros() -> AsyncGenerator[Machine]:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    pytest.importorskip("rclpy")
    with warnings.catch_warnings():  # its parser imports a module that Python has deprecated
        warnings.simplefilter("ignore")
        importlib.import_module("rosidl_parser.parser")
    import rcp_ros2
    from backends.ros2 import interfaces
    from backends.ros2.robot import Wheels, fresh_domain

    if not interfaces.have_tools():
        pytest.skip("nav2_msgs cannot be built")
    domain = fresh_domain()
    rover = Wheels(domain, str(interfaces.built()), shared_memory=False)
    rover.start()

    def truth() -> Truth:
        real = rover.tell("truth")
        moves = abs(real["v"]) > 0.02 or abs(real["w"]) > 0.02
        return Truth(real["x"], real["y"], not moves and not real["running"])

    try:
        options = {"domain_id": domain, "limits": {"speed": 0.8, "turn": 1.5}}
        async with _gateway(rcp_ros2.rcp_backends(), options) as (served, url):
            yield Machine(url, served, truth, 0.2, 1.0)
    finally:
        rover.stop()


MACHINES: Mapping[str, Callable[[], AbstractAsyncContextManager[Machine]]] = {
    "simulated rover": _simulated,
    "ROS 2 rover": _ros,
    "ArduPilot rover": lambda: _vehicle("rover", 1.3),
    "copter": lambda: _vehicle("copter", 0.8),
    "rover with physics": _physics,
    "CAN wheels": _wheels,
}
