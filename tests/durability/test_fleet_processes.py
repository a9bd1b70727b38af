"""A router, hubs and a robot's gateway as processes of their own: whichever is killed comes back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from configuration import backend, key, listener, table
from durability.process import ADMIN, CONFIG, Served, until
from ports import free_port

_ROUTER = """
import signal, sys
from rcp_zenoh.session import configuration
import zenoh
with zenoh.open(configuration("router", listen=[sys.argv[1]], silence=1.0)):
    print("up", flush=True)
    signal.pause()
"""
POSE = "/tenant/alpha/sensor/r7/pose"
MOVE = "/tenant/alpha/action/r7/move_to"


class Fleet:
    """The processes: one hub, or two."""

    def __init__(self, folder: Path, *hubs: str) -> None:
        self._endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._folder = folder
        self._router = self._start_router()
        self.robot = self.start_robot()
        self.hubs: dict[str, Served] = {}
        for hub in hubs or ("h1",):
            self.start_hub(hub)

    def _start_router(self) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", _ROUTER, self._endpoint]
        router = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert router.stdout is not None
        assert router.stdout.readline() == "up\n"
        return router

    def restart_router(self) -> None:
        self.kill_router()
        until(lambda: self.lost)
        self._router = self._start_router()

    def kill_router(self) -> None:
        self._router.kill()
        self._router.communicate()

    def _start(self, name: str, text: str) -> Served:
        folder = self._folder / name
        folder.mkdir(exist_ok=True)
        return Served(folder, folder / "store.db", text)

    def start_robot(self) -> Served:
        here: dict[str, Any] = {"gateway": "r7", "tenant": "alpha", "silence": 1.0}
        zenoh = table("transports.zenoh", connect=[self._endpoint], **here)
        self.robot = self._start("robot", CONFIG + zenoh)
        return self.robot

    def start_hub(self, name: str = "h1") -> None:
        link: dict[str, Any] = {"connect": [self._endpoint], "silence": 1.0}
        fleet = backend("fleet", use="fleet", hub=name, token=ADMIN, **link)
        self.hubs[name] = self._start(name, listener() + fleet + key("admin", ADMIN))

    @property
    def hub(self) -> Served:
        """The first of the hubs."""
        return self.hubs["h1"]

    @property
    def ready(self) -> bool:
        """Whether each hub reaches the robot."""
        return all(map(_reaches, self.hubs.values()))

    @property
    def lost(self) -> bool:
        """Whether no hub reaches it."""
        return not any(map(_reaches, self.hubs.values()))

    def commands(self) -> list[dict[str, Any]]:
        """List the commands that the robot's gateway knows."""
        return self.robot.ask("GET", "/system/commands")["body"]


def _reaches(hub: Served) -> bool:
    backend: dict[str, Any] = hub.status()["backends"][0]
    reply = hub.ask("GET", f"{POSE}?fresh=true")
    return backend["state"] == "ready" and reply["status"] == "completed"


@contextmanager
def _fleet(folder: Path, *hubs: str) -> Iterator[Fleet]:
    fleet = Fleet(folder, *hubs)
    try:
        until(lambda: fleet.ready)
        yield fleet
    finally:
        for hub in fleet.hubs.values():
            hub.kill()
        fleet.robot.kill()
        fleet.kill_router()


def test_a_router_that_was_killed_is_found_again(tmp_path: Path) -> None:
    with _fleet(tmp_path) as fleet:
        fleet.restart_router()
        until(lambda: fleet.ready)


def test_a_robot_gateway_that_was_killed_is_found_again(tmp_path: Path) -> None:
    with _fleet(tmp_path) as fleet:
        fleet.robot.kill()
        until(lambda: not fleet.ready)
        fleet.start_robot()
        until(lambda: fleet.ready)


def test_a_hub_that_was_killed_finds_its_robot_and_what_runs_there_ends_once(
    tmp_path: Path,
) -> None:
    with _fleet(tmp_path) as fleet:
        started = fleet.hub.ask("POST", MOVE, {"position": {"x": 1.0, "y": 0.0}})
        assert started["status"] in ("accepted", "in_progress"), started
        until(fleet.commands)
        fleet.hub.kill()
        fleet.start_hub()
        until(lambda: fleet.ready)
        until(lambda: fleet.commands()[0]["status"] == "completed")
        assert len(fleet.commands()) == 1


def test_two_hubs_find_their_robot_and_its_router_again_and_a_command_ends_once(
    tmp_path: Path,
) -> None:
    with _fleet(tmp_path, "h1", "h2") as fleet:
        far = {"position": {"x": 5.0, "y": 0.0}, "speed": 0.1}
        started = fleet.hub.ask("POST", MOVE, far)
        assert started["status"] in ("accepted", "in_progress"), started
        # Before that, its key may not be stored yet: the robot has not been told, and the hub may ask again.
        until(lambda: [one["status"] for one in fleet.commands()] == ["in_progress"])
        fleet.robot.kill()
        until(lambda: fleet.lost)
        fleet.start_robot()
        until(lambda: fleet.ready)
        (ended,) = fleet.commands()
        # What ran when its gateway was killed is not begun again.
        assert ended["status"] == "failed", ended
        until(lambda: _last(fleet.hub)["status"] == "failed")
        fleet.restart_router()
        until(lambda: fleet.ready)
        moved = fleet.hubs["h2"].ask("POST", MOVE, {"position": {"x": 0.1, "y": 0.0}})
        assert moved["status"] in ("accepted", "in_progress", "completed"), moved
        until(lambda: [one["status"] for one in fleet.commands()].count("completed") == 1)
        assert len(fleet.commands()) == 2


def _last(hub: Served) -> dict[str, Any]:
    """Return the last command that a hub knows."""
    return hub.ask("GET", "/system/commands")["body"][-1]
