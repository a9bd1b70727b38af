"""A router, a hub and a robot's gateway as processes of their own: whichever is killed comes back."""

from __future__ import annotations

import socket
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
    """The three processes."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            self._endpoint = f"tcp/127.0.0.1:{one.getsockname()[1]}"
        self._folder = folder
        self._router = self._start_router()
        self.robot = self.start_robot()
        self.hub = self.start_hub()

    def _start_router(self) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", _ROUTER, self._endpoint]
        router = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert router.stdout is not None
        assert router.stdout.readline() == "up\n"
        return router

    def restart_router(self) -> None:
        self.kill_router()
        until(lambda: not self.ready)
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

    def start_hub(self) -> Served:
        link: dict[str, Any] = {"connect": [self._endpoint], "silence": 1.0}
        fleet = backend("fleet", use="fleet", hub="h1", token=ADMIN, **link)
        self.hub = self._start("hub", listener() + fleet + key("admin", ADMIN))
        return self.hub

    @property
    def ready(self) -> bool:
        """Whether the hub reaches the robot."""
        backend: dict[str, Any] = self.hub.status()["backends"][0]
        return backend["state"] == "ready" and self.reads

    @property
    def reads(self) -> bool:
        """Whether the hub reads a value of the robot."""
        reply = self.hub.ask("GET", f"{POSE}?fresh=true")
        return reply["status"] == "completed"

    def commands(self) -> list[dict[str, Any]]:
        """List the commands that the robot's gateway knows."""
        return self.robot.ask("GET", "/system/commands")["body"]


@contextmanager
def _fleet(folder: Path) -> Iterator[Fleet]:
    fleet = Fleet(folder)
    try:
        until(lambda: fleet.ready)
        yield fleet
    finally:
        fleet.hub.kill()
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
