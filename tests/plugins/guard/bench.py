"""A device and a gateway, each a process of its own, and what both say."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

SOON = "[safety]\nguard_bound = 1.0\n"  # or each test would wait for its guard to end
HERE = Path(__file__).parent
BOUND = 90.0  # s that any wait of a test may take: three processes start, on a busy machine
AFTER = 0.5  # s, the default of `guard_after`
WITHIN = AFTER + 0.2  # s in which a device is to be told to stop
SEEN = 0.2  # s in which it is to be told where the gateway's process ended


class Child:
    """A process that takes JSON lines and says JSON lines."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.facts: list[dict[str, Any]] = []
        self.log: list[str] = []
        self._changed = asyncio.Event()
        self._readers = [
            asyncio.create_task(self._read(process.stdout, self._fact)),
            asyncio.create_task(self._read(process.stderr, self.log.append)),
        ]

    def _fact(self, line: str) -> None:
        self.facts.append(json.loads(line))

    async def _read(self, stream: Any, take: Callable[[str], None]) -> None:
        while line := await stream.readline():
            take(line.decode())
            self._changed.set()
        self._changed.set()

    def say(self, **message: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(message).encode() + b"\n")

    async def until(
        self, wanted: Callable[[dict[str, Any]], Any], since: int = 0
    ) -> dict[str, Any]:
        """Return the first fact for which `wanted` holds, of those after the first `since`."""
        try:
            async with asyncio.timeout(BOUND):
                while True:
                    for fact in self.facts[since:]:
                        if wanted(fact):
                            return fact
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            raise AssertionError((self.facts[-5:], self.log[-5:])) from None

    async def ask(self, key: str, **message: Any) -> dict[str, Any]:
        """Say something, and return the next fact with a key."""
        since = len(self.facts)
        self.say(**message)
        return await self.until(lambda fact: key in fact, since)

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    async def end(self) -> None:
        """End the process, whatever it does, by its id."""
        if self.process.returncode is None:
            with suppress(ProcessLookupError):
                self.process.kill()
        await self.process.wait()
        async with asyncio.timeout(BOUND):
            await asyncio.gather(*self._readers)


@asynccontextmanager
async def child(script: str, *arguments: str) -> AsyncGenerator[Child]:
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, str(HERE / script), *arguments),
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1])},
        limit=2**24,
    )
    started = Child(process)
    try:
        yield started
    finally:
        await started.end()


class Bench:
    """A gateway that drives a device, with a guard."""

    def __init__(self, device: Child, gateway: Child) -> None:
        self.device = device
        self.gateway = gateway

    async def guard(self, state: str = "ready", **wanted: Any) -> dict[str, Any]:
        """Wait until the guard is in a state, and other facts as wanted; return all about it."""
        found: dict[str, Any] = {}

        async def look() -> bool:
            nonlocal found
            found = await self.gateway.ask("guard", do="guard")
            report = found["guard"]
            return report["state"] == state and all(report[k] == v for k, v in wanted.items())

        await until(look)
        return found

    async def other_guard(self, pid: int) -> dict[str, Any]:
        """Wait until another process is the guard, and is ready."""
        found: dict[str, Any] = {}

        async def look() -> bool:
            nonlocal found
            found = await self.guard()
            return found["pid"] not in (pid, None)

        await until(look)
        return found

    async def drive(self, velocity: float = 1.0) -> None:
        """Drive, and see the device move."""
        self.gateway.say(do="drive", velocity=velocity)
        await self.device.until(lambda fact: fact.get("velocity") == velocity)

    async def freeze(self, how: str) -> float:
        """Stop the gateway's loop in one way; return when it stood."""
        if how in ("SIGSTOP", "SIGKILL"):
            at = asyncio.get_running_loop().time()
            self.gateway.signal(getattr(signal, how))
            return at
        return (await self.gateway.ask("frozen", do="hang", how=f"{how} 250"))["at"]

    async def stopped(self, by: str = "udp") -> float:
        """Wait until the device was stopped by something; return when."""
        moved = next(i for i, fact in enumerate(self.device.facts) if fact.get("velocity"))
        stop = await self.device.until(
            lambda fact: fact.get("by") == by and fact["velocity"] == 0.0, moved
        )
        return stop["at"]

    def stops(self) -> list[dict[str, Any]]:
        """List the stops that the guard has sent."""
        return [fact for fact in self.device.facts if fact.get("told") == "STOP"]


@asynccontextmanager
async def bench(
    plan: Callable[[int], dict[str, Any] | None],
    more: str = SOON,
    device: tuple[str, ...] = ("udp",),
) -> AsyncGenerator[Bench]:
    """Start a device, then a gateway whose backend gives the plan made for the device's port."""
    async with child("device.py", *device) as robot:
        port = (await robot.until(lambda fact: "port" in fact))["port"]
        asked = {"plan": plan(port), "port": port, "more": more}
        async with child("gateway.py", json.dumps(asked)) as gateway:
            await gateway.until(lambda fact: "ready" in fact)
            yield Bench(robot, gateway)


async def until(holds: Callable[[], Awaitable[bool]]) -> None:
    """Look again and again until something holds."""
    async with asyncio.timeout(BOUND):
        while not await holds():  # noqa: ASYNC110 - what it looks at is in another process
            await asyncio.sleep(0.03)


async def gone(pid: int) -> None:
    """Wait until a process has ended."""

    async def look() -> bool:
        return not lives(pid)

    await until(look)


def by_udp(port: int) -> dict[str, Any]:
    return {
        "sender": "udp",
        "data": {"to": ["127.0.0.1", port], "frames": [b"STOP".hex()]},
        "period": 0.05,
    }


def lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
