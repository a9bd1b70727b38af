"""The guard process by itself, spoken to as the gateway speaks to it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

BOUND = 60.0  # s that any wait of a test may take


class Guarded:
    """The gateway's end, and two devices."""

    def __init__(self, ours: socket.socket, process: subprocess.Popen[bytes]) -> None:
        self.socket = ours
        self.process = process
        self.devices = {name: device() for name in ("a", "b")}
        self.said = ours.makefile("r")
        self._reports: list[dict[str, Any]] = []

    def send(self, **message: Any) -> None:
        self.socket.sendall(json.dumps(message).encode() + b"\n" if message else b"\n")

    def plans(self, **more: Any) -> dict[str, Any]:
        return {
            f"{name}/stop": {
                "group": name,
                "sender": "udp",
                "data": {"to": list(heard.getsockname()), "frames": [b"STOP".hex()]},
                "period": 0.02,
            }
            for name, heard in self.devices.items()
        } | more

    def event(self, **wanted: Any) -> dict[str, Any]:
        """Take the first report that has these facts."""
        until = time.monotonic() + BOUND
        while True:
            for report in self._reports:
                if report | wanted == report:
                    self._reports.remove(report)
                    return report
            line = self.said.readline()
            if not line or time.monotonic() > until:
                raise AssertionError(f"the guard did not report {wanted}")
            self._reports.append(json.loads(line))

    def ended(self) -> int:
        return self.process.wait(BOUND)


def device() -> socket.socket:
    heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    heard.bind(("127.0.0.1", 0))
    heard.settimeout(BOUND)
    return heard


def silent(heard: socket.socket) -> bool:
    heard.setblocking(False)
    try:
        heard.recv(100)
    except BlockingIOError:
        return True
    return False


@pytest.fixture
def guarded() -> Iterator[Guarded]:
    with running(after=0.3, bound=1.0) as guard:
        yield guard


@contextmanager
def running(*, after: float, bound: float) -> Iterator[Guarded]:
    ours, theirs = socket.socketpair()
    ours.settimeout(BOUND)
    command = [sys.executable, "-P", "-m", "rcp_guard", "--fd", str(theirs.fileno())]
    command += ["--after", str(after), "--bound", str(bound)]
    with theirs:
        process = subprocess.Popen(
            command, pass_fds=(theirs.fileno(),), start_new_session=True, stderr=subprocess.PIPE
        )
    guard = Guarded(ours, process)
    try:
        yield guard
    finally:
        guard.said.close()
        ours.close()
        for heard in guard.devices.values():
            heard.close()
        process.kill()
        process.communicate()


def test_only_what_is_armed_is_stopped(guarded: Guarded) -> None:
    guarded.send(plans=guarded.plans())
    for name in ("a", "b"):
        guarded.event(event="sender", plan=f"{name}/stop", state="ready")
    guarded.send(armed=["a"])
    assert guarded.event(event="stopped")["groups"] == ["a"]
    assert guarded.devices["a"].recv(100) == b"STOP"
    assert silent(guarded.devices["b"])


def test_a_goodbye_ends_it_and_nothing_is_sent(guarded: Guarded) -> None:
    guarded.send(plans=guarded.plans())
    guarded.event(event="sender", state="ready")
    guarded.send(armed=["a", "b"])
    guarded.send(bye=True)
    assert guarded.ended() == 0
    assert all(silent(heard) for heard in guarded.devices.values())


def test_a_plan_that_is_replaced_is_sent_as_it_is_now(guarded: Guarded) -> None:
    plans = guarded.plans()
    guarded.send(plans=plans)
    guarded.event(event="sender", plan="a/stop", state="ready")
    plans["a/stop"]["data"]["frames"] = [b"NEW".hex()]
    guarded.send(plans=plans)
    guarded.event(event="sender", plan="a/stop", state="ready")
    guarded.send(armed=["a"])
    assert guarded.devices["a"].recv(100) == b"NEW"


def test_a_plan_that_lasts_is_sent_for_that_long_and_again_at_the_next_stop() -> None:
    with running(after=0.3, bound=5.0) as guard:
        plans = guard.plans()
        plans["a/stop"]["lasts"] = 0.2
        guard.send(plans=plans, armed=["a", "b"])
        for name in ("a", "b"):
            guard.event(event="sender", plan=f"{name}/stop", state="ready")
        for _ in range(2):
            guard.event(event="stopped")
            times = told(guard.devices["a"])
            assert 0.1 < times[-1] - times[0] < 2.0
            while not silent(guard.devices["b"]):  # what had come before
                pass
            guard.devices["b"].settimeout(BOUND)
            assert guard.devices["b"].recv(100) == b"STOP"  # it has no such limit
            for _ in range(4):  # the gateway is back
                guard.send()
                time.sleep(0.05)
            guard.event(event="released")


def told(heard: socket.socket) -> list[float]:
    """Return when a device was told to stop, up to a pause of 0.5 s."""
    times = []
    heard.settimeout(BOUND)
    with suppress(TimeoutError):
        while True:
            assert heard.recv(100) == b"STOP"
            times.append(time.monotonic())
            heard.settimeout(0.5)
    return times


def test_a_plan_that_is_taken_back_is_not_sent(guarded: Guarded) -> None:
    guarded.send(plans=guarded.plans())
    guarded.event(event="sender", plan="a/stop", state="ready")
    guarded.send(plans={})
    guarded.send(armed=["a"])
    guarded.event(event="stopped")
    guarded.event(event="released")
    assert silent(guarded.devices["a"])


def test_what_it_does_not_understand_ends_nothing(guarded: Guarded) -> None:
    guarded.socket.sendall(b'not JSON\n[1]\n{"plans": {"x": {"sender": "no such"}}}\n')
    told = guarded.event(event="sender", plan="x", state="missing")
    assert "no such" in told["detail"]
    guarded.send(
        plans=guarded.plans(
            z=5, w={"period": "soon"}, v={"lasts": "long"}, y={"sender": "udp", "data": {"to": 7}}
        )
    )
    guarded.event(event="sender", plan="z", state="missing")
    guarded.event(event="sender", plan="w", state="missing")
    guarded.event(event="sender", plan="v", state="missing")
    assert "udp" in guarded.event(event="sender", plan="y", state="missing")["detail"]
    guarded.send(armed=["a"])
    assert guarded.devices["a"].recv(100) == b"STOP"


def test_an_address_that_cannot_be_resolved_is_tried_again(guarded: Guarded) -> None:
    plan = {"sender": "udp", "data": {"to": ["no.such.invalid", 1], "frames": ["00"]}}
    guarded.send(plans={"x": plan})
    assert guarded.event(event="sender", plan="x", state="failed")["detail"]


@pytest.mark.parametrize("interface", ["virtual", "slcan", "serial"])
def test_a_bus_that_a_second_process_cannot_use_is_said_to_be_one(
    guarded: Guarded, interface: str
) -> None:
    pytest.importorskip("can")
    data = {"bus": {"interface": interface, "channel": "x"}, "frames": []}
    guarded.send(plans={"x": {"sender": "can", "data": data}})
    assert interface in guarded.event(event="sender", state="missing")["detail"]


def test_reports_that_nobody_reads_delay_no_stop() -> None:
    with running(after=0.3, bound=1.0) as guard:
        name = "x" * 4000
        guard.send(plans=guard.plans())
        for number in range(300):  # more than the socket takes
            guard.send(plans=guard.plans(**{f"{name}{number}": {"sender": "no such"}}))
        guard.send(armed=["a"])
        assert guard.devices["a"].recv(100) == b"STOP"


def test_a_plan_is_left_only_to_a_guard_that_has_the_same_one() -> None:
    with running(after=0.3, bound=5.0) as old, running(after=0.5, bound=1.0) as new:
        plans = old.plans()
        old.send(plans=plans)
        for name in ("a", "b"):
            old.event(event="sender", plan=f"{name}/stop", state="ready")
        old.send(armed=["a", "b"])
        old.socket.shutdown(socket.SHUT_WR)
        for heard in old.devices.values():
            assert heard.recv(100) == b"STOP"
        new.send(plans={"elsewhere": plans["a/stop"]})
        silence(old.devices["a"], new)
        while not silent(old.devices["b"]):  # what had come before
            pass
        old.devices["b"].settimeout(BOUND)
        assert old.devices["b"].recv(100) == b"STOP"


def silence(heard: socket.socket, new: Guarded) -> None:
    """Give heartbeats until a device hears no stop any more."""
    until = time.monotonic() + BOUND
    heard.settimeout(0.2)
    while time.monotonic() < until:
        new.send()
        try:
            heard.recv(100)
        except TimeoutError:
            return
    raise AssertionError("the stops went on")


def test_it_takes_next_to_no_time_while_nothing_happens() -> None:
    with running(after=0.5, bound=1.0) as guard:
        guard.send(plans=guard.plans())
        guard.event(event="sender", state="ready")
        guard.send(armed=["a"])
        before = spent(guard.process.pid)
        until = time.monotonic() + 2.0
        while time.monotonic() < until:
            guard.send()
            time.sleep(0.1)
        assert spent(guard.process.pid) - before < 0.1  # s of the processor in two seconds


def spent(pid: int) -> float:
    import psutil

    times = psutil.Process(pid).cpu_times()
    return times.user + times.system


def test_it_imports_nothing_of_the_gateway() -> None:
    program = (
        "import sys, rcp_guard.__main__, rcp_guard.senders.udp, rcp_guard.senders.can_bus,"
        " rcp_guard.senders.ros2\n"
        "print([m for m in sys.modules if m.partition('.')[0] in"
        " ('rcp_kernel', 'msgspec', 'structlog', 'anyio', 'uvloop', 'can', 'rclpy')])"
    )
    found = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, check=True, env=os.environ.copy()
    )
    assert found.stdout.strip() == b"[]"
