"""A gateway that is frozen or killed leaves no ROS 2 robot driving, and finds it at rest afterwards.

The gateway is `rcpd serve` in a process of its own, driven over HTTP and WebSocket; the base obeys what it
was told last for ever, so that only the guard can stop it. Its wheels are looked at in its process.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest
from websockets.sync.client import connect

from backends.ros2.robot import Base, Commander, fresh_domain
from configuration import backend, key, listener, table
from timing import Load, measured_load

pytestmark = pytest.mark.paired
BOUND = 60.0  # s that any wait of a test may take
STAYS = 2.0  # s for which the wheels are looked at once they rest
AFTER = 0.5  # s of `guard_after`
BRAKING = 0.25  # s from 0.5 m/s, at 2 m/s²
TOLD = 0.75  # s for the base to be told, at most; a busy machine has more
SPEED = 0.5  # m/s
KEY = "admin-of-the-base"
VELOCITY = "actuator/velocity"
MAP = {
    "/actuator/velocity": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
    "/action/navigate": {"action": "/navigate", "unit": "1"},
}
HANGING = """
import asyncio
from contextlib import asynccontextmanager

import msgspec

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend


class NoOptions(msgspec.Struct):
    pass


class Hanging(BaseBackend):
    async def execute(self, name, value, progress):
        while True:
            pass


@asynccontextmanager
async def open_hanging(_config, host):
    host.declare(Resource(name="service/hang", description="Hangs.", moves=False))
    yield Hanging()


@hookimpl
def rcp_backends():
    return [BackendKind("hanging", NoOptions, open_hanging)]
"""
"""A plugin that blocks the event loop."""


class Gateway:
    """A gateway in a process of its own, and what it is asked over HTTP."""

    def __init__(self, process: subprocess.Popen[bytes], url: str) -> None:
        self.process = process
        self.url = url
        self._http = httpx.Client(
            base_url=f"{url}/rcp/v1",
            headers={"Authorization": f"Bearer {KEY}"},
            timeout=BOUND,
            trust_env=False,
        )

    def ask(self, method: str, path: str, body: Any = None) -> dict[str, Any]:
        more = {} if body is None else {"json": body}
        return self._http.request(method, path, **more).json()

    def status(self) -> dict[str, Any]:
        return self.ask("GET", "/context/system/status")["body"]

    def drive(self, speed: float = SPEED) -> dict[str, Any]:
        """Write a velocity that stands for longer than any test."""
        path = f"/context/tenant/alpha/{VELOCITY}?valid_for=600"
        return self.ask("PUT", path, {"linear": {"x": speed}})

    def navigate(self) -> str:
        """Start a goal of half a minute; return the command's id."""
        reply = self.ask("POST", "/context/tenant/alpha/action/navigate", steps(600))
        assert reply["status"] == "accepted", reply
        return reply["command"]

    def estop(self, **body: Any) -> dict[str, Any]:
        return self.ask("POST", "/context/system/estop?wait=30", body)

    def stop_of_base(self) -> dict[str, Any]:
        """Return how far the stop of the base has come."""
        robots = self.ask("GET", "/context/system/estop")["body"]["robots"]
        return next(iter(robots.values()))

    def signal(self, number: int) -> float:
        """Send a signal; return when."""
        at = time.monotonic()
        self.process.send_signal(number)
        return at

    def kill(self) -> float:
        """End it as the kernel does when memory is short, and see it gone; return when."""
        at = self.signal(signal.SIGKILL)
        self.process.wait(BOUND)
        return at

    def close(self) -> None:
        self._http.close()


class Scene:
    """The base, and the gateways that are started in front of it, one after the other."""

    def __init__(self, folder: Path, domain: int, base: Base) -> None:
        self.base = base
        self._folder = folder
        self._domain = domain

    @property
    def truth(self) -> dict[str, Any]:
        return self.base.tell("truth")

    @contextmanager
    def gateway(self, *, guard: bool = True, more: str = "") -> Generator[Gateway]:
        """Serve with the same store as those before; ends with the block, as does its guard."""
        config, log = self._folder / "rcp.toml", self._folder / "log"
        config.write_text(
            listener()
            + table("safety", guard=guard)
            + table("store", path=self._folder / "rcp.db")
            + backend(use="ros2", domain_id=self._domain, expose=["/odom"], map=MAP)
            + more
            + key("admin", KEY)
        )
        rcpd = Path(sys.executable).with_name("rcpd")
        environment = {**os.environ, "PYTHONPATH": str(self._folder)}
        with log.open("wb") as told:
            process = subprocess.Popen([rcpd, "serve", config], stderr=told, env=environment)
        guards: list[psutil.Process] = []
        made: Gateway | None = None
        try:
            url = until(lambda: address(log, process), "it serves")
            made = Gateway(process, url)
            until(lambda: self._is_ready(made, guard=guard), "it is ready")
            guards = psutil.Process(process.pid).children()
            yield made
        finally:
            if made is not None:
                made.close()
            process.kill()
            process.wait(BOUND)
            for one in guards:
                with suppress(psutil.NoSuchProcess):
                    one.kill()
            print(log.read_text()[-3000:])  # noqa: T201 - shown when a test fails

    def _is_ready(self, gateway: Gateway, *, guard: bool) -> bool:
        status = gateway.status()
        tries = ("PUT", VELOCITY, {"linear": {"x": SPEED}}), ("POST", "action/navigate", steps(1))
        there = True
        for method, name, body in tries:
            reply = gateway.ask(method, f"/context/tenant/alpha/{name}?dry_run=true", body)
            latched = reply.get("error", {}).get("code") == "estop_active"
            there = there and (reply.get("status") == "completed" or latched)
        return there and status["guard"]["state"] == ("ready" if guard else "off")

    def drives(self, gateway: Gateway) -> None:
        """Have the base driven at full speed."""
        until(lambda: gateway.drive()["status"] == "completed", "a velocity is taken")
        until(lambda: self.truth["wheel"] >= SPEED - 0.01, "the base drives")

    def navigates(self, gateway: Gateway) -> str:
        """Have a goal drive the base."""
        command = gateway.navigate()
        until(lambda: self.truth["running"] and self.truth["wheel"] > 0.3, "a goal drives")
        return command

    def rests(self, since: float) -> float:
        """Wait until the wheels rest; return how many seconds after a time that was."""
        at = until(lambda: self.base.tell("rested", since=since), "the base rests")
        return at - since

    def stays(self) -> None:
        """See the base rest for a while."""
        time.sleep(STAYS)  # in which nothing may move
        assert self.base.tell("peak", seconds=STAYS) == 0.0
        assert self.truth["running"] == 0


def until(look: Callable[[], Any], what: str) -> Any:
    """Look again and again until something is there."""
    end = time.monotonic() + BOUND
    while not (found := look()):
        assert time.monotonic() < end, f"not within {BOUND:g} s: {what}"
        time.sleep(0.03)
    return found


def address(log: Path, process: subprocess.Popen[bytes]) -> str | None:
    """Return where a gateway serves, once its log says so."""
    assert process.poll() is None, log.read_text()
    for line in log.read_text().splitlines():
        if "serving on " in line:
            return line.rpartition(" ")[2].strip()
    return None


def steps(count: int) -> dict[str, Any]:
    return {"nested_field": {"int32_value": count}}


def show(record_property: Callable[[str, object], None], what: str, seconds: float) -> None:
    record_property("seconds_to_rest", round(seconds, 3))
    print(f"{what}: at rest after {seconds:.3f} s")  # noqa: T201 - the measured times


@pytest.fixture(scope="module")
def domain() -> int:
    return fresh_domain()


@pytest.fixture(scope="module")
def module_base(domain: int) -> Iterator[Base]:
    base = Base(domain)
    base.start()
    yield base
    base.stop()


@pytest.fixture
def scene(module_base: Base, domain: int, tmp_path: Path) -> Scene:
    """The base at rest, without a gateway."""
    module_base.tell("renew")
    until(lambda: module_base.tell("truth")["running"] == 0, "no goal is left")
    return Scene(tmp_path, domain, module_base)


@pytest.fixture
def load() -> Iterator[Load]:
    """What else the machine does meanwhile."""
    with measured_load() as load:
        yield load


@pytest.fixture
def commander(domain: int) -> Iterator[Commander]:
    commander = Commander(domain)
    commander.start()
    yield commander
    commander.stop()


def test_a_killed_gateway_leaves_no_base_driving(
    scene: Scene, load: Load, record_property: Any
) -> None:
    with scene.gateway() as gateway:
        scene.drives(gateway)
        took = scene.rests(gateway.kill())
        show(record_property, "SIGKILL, velocity", took)
        assert took < load.allows(BRAKING + TOLD)
        scene.stays()


def test_a_killed_gateway_leaves_no_goal_driving_and_tells_of_it_when_it_is_back(
    scene: Scene, load: Load, record_property: Any
) -> None:
    with scene.gateway() as gateway:
        command = scene.navigates(gateway)
        took = scene.rests(gateway.kill())
        show(record_property, "SIGKILL, goal", took)
        assert took < load.allows(BRAKING + TOLD)
        with scene.gateway() as other:  # beside the guard of the one before
            assert_failed(other, command)
            scene.stays()
            assert other.navigate()  # a new goal is nobody's to cancel
            until(lambda: scene.truth["wheel"] > 0.3, "a new goal drives")
            time.sleep(1.0)  # in which it must not be cancelled
            assert scene.truth["running"] == 1


def test_a_frozen_gateway_leaves_nothing_driving_and_nothing_goes_on_when_it_thaws(
    scene: Scene, load: Load, record_property: Any
) -> None:
    with scene.gateway() as gateway:
        scene.drives(gateway)
        took = scene.rests(gateway.signal(signal.SIGSTOP))
        show(record_property, "SIGSTOP, velocity", took)
        assert took < load.allows(AFTER + BRAKING + TOLD)
        scene.stays()
        gateway.signal(signal.SIGCONT)
        scene.stays()
        until(lambda: gateway.status()["guard"]["stops"] == 1, "it knows of the stop")
        scene.drives(gateway)  # who commands it anew is obeyed

        gateway.drive(0.0)
        until(lambda: scene.truth["wheel"] == 0, "it rests")
        command = scene.navigates(gateway)
        took = scene.rests(gateway.signal(signal.SIGSTOP))
        show(record_property, "SIGSTOP, goal", took)
        assert took < load.allows(AFTER + BRAKING + TOLD)
        scene.stays()
        gateway.signal(signal.SIGCONT)
        scene.stays()
        found = until(lambda: ended(gateway, command), "the command has ended")
        assert found["status"] in ("cancelled", "failed")


def test_what_was_sent_to_a_frozen_gateway_moves_nothing_when_it_thaws(
    scene: Scene, load: Load
) -> None:
    with scene.gateway() as gateway, stream(gateway) as send:
        until(lambda: send(drive(0.5)) or scene.truth["wheel"] >= SPEED - 0.01, "the base drives")
        began = gateway.signal(signal.SIGSTOP)
        until(lambda: send(drive(0.5)) or scene.base.tell("rested", since=began), "the base rests")
        assert scene.rests(began) < load.allows(AFTER + BRAKING + TOLD)
        gateway.signal(signal.SIGCONT)
        scene.stays()


def test_a_plugin_that_blocks_the_loop_leaves_no_base_driving(
    scene: Scene, load: Load, tmp_path: Path, record_property: Any
) -> None:
    (tmp_path / "hanging.py").write_text(HANGING)
    about = tmp_path / "hanging-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: hanging\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[rcp.backends]\nhanging = hanging\n")
    more = backend(tenant="beta", use="hanging")
    with scene.gateway(more=more) as gateway, stream(gateway) as send:
        scene.drives(gateway)
        since = time.monotonic()
        send({"type": "execute", "id": "hang", "path": "/tenant/beta/service/hang"})
        took = scene.rests(since)
        show(record_property, "while True, velocity", took)
        assert took < load.allows(AFTER + BRAKING + TOLD)
        scene.stays()


def test_a_goal_that_nobody_guarded_is_cancelled_by_the_next_gateway(scene: Scene) -> None:
    with scene.gateway(guard=False) as gateway:
        command = scene.navigates(gateway)
        gateway.kill()
        assert scene.truth["running"] == 1
    with scene.gateway(guard=False) as gateway:
        assert_failed(gateway, command)
        until(lambda: scene.truth["running"] == 0, "the goal is cancelled")
        scene.rests(time.monotonic())
        scene.stays()
        assert scene.truth["finished"] == 0


def test_an_estop_outlives_its_gateway(scene: Scene, commander: Commander) -> None:
    with scene.gateway() as gateway:
        scene.drives(gateway)
        assert gateway.estop()["status"] == "completed"
        gateway.kill()
        scene.stays()
    with scene.gateway() as gateway:
        confirmed(scene, gateway)
        gateway.kill()
    # Without a guard somebody else drives the base while there is no gateway.
    until(lambda: commander.tell("hears"), "the commander is heard")
    until(lambda: commander.tell("say", speed=SPEED) or scene.truth["wheel"] > 0.3, "it drives")
    with scene.gateway(guard=False) as gateway:
        confirmed(scene, gateway)


def confirmed(scene: Scene, gateway: Gateway) -> None:
    """See a gateway that has just started latched, and the base confirmed at rest and there."""
    until(lambda: gateway.stop_of_base()["state"] == "confirmed", "the stop is confirmed")
    assert scene.truth["wheel"] == 0.0
    assert gateway.drive()["error"]["code"] == "estop_active"
    scene.stays()


def assert_failed(gateway: Gateway, command: str) -> None:
    found = ended(gateway, command)
    assert found is not None
    assert found["status"] == "failed"
    assert "the gateway stopped" in str(found), found


def ended(gateway: Gateway, command: str) -> dict[str, Any] | None:
    """Return the last that is known of a command, once it has ended."""
    found = gateway.ask("GET", f"/commands/{command}")["body"]
    return found if found["status"] not in ("accepted", "in_progress") else None


@contextmanager
def stream(gateway: Gateway) -> Generator[Callable[[dict[str, Any]], None]]:
    """Connect by WebSocket; yield what sends an envelope and waits for nothing."""
    address = gateway.url.replace("http", "ws", 1) + "/rcp/v1/ws"
    with connect(
        address,
        subprotocols=["rcp.v1.json"],  # pyright: ignore[reportArgumentType]
        proxy=None,
        close_timeout=0.1,  # the gateway may stand still
    ) as socket:
        hello = {"type": "hello", "id": "h", "body": {"client": "test/1", "token": KEY}}
        socket.send(json.dumps(hello))
        assert json.loads(socket.recv(BOUND))["status"] == "completed"
        yield lambda envelope: socket.send(json.dumps(envelope))


def drive(valid_for: float) -> dict[str, Any]:
    """Return the envelope that writes a velocity."""
    path = f"/tenant/alpha/{VELOCITY}"
    body = {"linear": {"x": SPEED}}
    return {"type": "write", "id": "w", "path": path, "body": body, "valid_for": valid_for}
