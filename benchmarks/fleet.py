"""A fleet behind one hub: discovery, memory, latency, throughput and the e-stop.

Each robot is a whole gateway: the real kernel and transport with a Zenoh session of its own, around
a scripted robot with 20 resources and a pose of 10 Hz. A few processes share them. The router has a
process of its own too, so that the hub's figures are the hub's.

Run: python benchmarks/fleet.py [robots] [processes]
"""

from __future__ import annotations

import asyncio
import functools
import gc
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from contextlib import AsyncExitStack

import psutil
import uvloop

ROBOTS, PROCESSES = 1000, 4
NEAR = 100  # robots whose poses are subscribed to
CLIENTS = 1, 4, 10  # that subscribe to the same poses
SECONDS = 4.0
SILENCE = 30.0  # s: a thousand robots on a busy machine are silent for longer than 3 s
KEY = "key-of-the-benchmark"
OFF = "[transports]\nasgi = false\nhttp = false\nws = false\nsse = false\n"
KEYS = f'[[keys]]\nname = "admin"\nrole = "admin"\nkey = "{KEY}"\n'
LIMITS = "[limits]\nsubscriptions = 5000\n"


def quiet() -> None:
    """Log nothing, and allow as many descriptors as the system does."""
    import logging

    from rcp_gateway.log import configure

    configure("CRITICAL", "json")
    logging.disable(logging.CRITICAL)
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def say(**facts: object) -> None:
    """Print one line for the parent."""
    print(json.dumps(facts), flush=True)


async def lines():
    """Read commands of the parent."""
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        yield line.split()


# -- the robots ----------------------------------------------------------------------------------


def resources():
    """Twenty resources of a small rover."""
    from rcp_kernel.model import Resource
    from rcp_kernel.types import PoseStamped, Twist, quantity

    metres = quantity("m", ge=0)
    return [
        Resource(name="sensor/pose", description="Pose.", value=PoseStamped),
        *(Resource(name=f"sensor/range{i}", description="Range.", value=metres) for i in range(8)),
        *(Resource(name=f"param/limit{i}", description="Limit.", value=metres) for i in range(6)),
        Resource(
            name="actuator/cmd_vel",
            description="Velocity.",
            value=Twist,
            safe=Twist(),
            valid_for=0.5,
        ),
        Resource(name="action/move_to", description="Go.", input=PoseStamped),
        Resource(name="action/dock", description="Dock."),
        Resource(name="service/reset", description="Reset."),
    ]


class Publishers:
    """Publish poses on many paths, as the robots do and, to compare, the hub itself."""

    def __init__(self) -> None:
        self._running: list[asyncio.Task[None]] = []

    def run(self, paths, rate: float) -> None:
        """Publish on each of these pairs of host and name at a rate, evenly spread over time."""
        for task in self._running:
            task.cancel()
        groups = [paths[i::10] for i in range(min(10, len(paths)))] if rate else []
        self._running = [
            asyncio.create_task(self._publish(group, rate, i / rate / 10))
            for i, group in enumerate(groups)
        ]

    async def _publish(self, group, rate: float, offset: float) -> None:
        from rcp_kernel.types import Point, PoseStamped

        loop = asyncio.get_running_loop()
        due = loop.time() + offset
        while True:
            await asyncio.sleep(max(0.0, due - loop.time()))
            due = max(due + 1 / rate, loop.time() - 1.0)
            pose = PoseStamped(position=Point(x=due % 100, y=2.0))
            for host, name in group:
                host.publish(name, pose, time.time_ns())


class Robots:
    """The robots of one process."""

    def __init__(self) -> None:
        self.all = []
        self.halts: dict[int, float] = {}
        """When each was halted first since the last look."""
        self.publishers = Publishers()

    def make(self, host):
        """Make one."""
        from rcp_gateway.testing import ScriptedRobot

        halts = self.halts

        class Rover(ScriptedRobot):
            async def halt(self) -> None:
                await super().halt()
                halts.setdefault(id(self), time.time())

        robot = Rover(host, *resources())
        self.all.append(robot)
        return robot

    def publish(self, rate: float, count: int) -> None:
        """Let the first `count` publish poses at a rate."""
        self.publishers.run([(robot.host, "sensor/pose") for robot in self.all[:count]], rate)


async def serve_robots(port: str, first: str, count: str) -> None:
    """Run gateways, and publish as the parent says."""
    from rcp_gateway import plugins
    from rcp_gateway.testing import scripted, serve
    from rcp_kernel.config.file import parse
    from rcpd.garbage import collected_at_rest

    # Each gateway would read the metadata of all packages five times.
    plugins.entry_points = functools.cache(plugins.entry_points)
    robots = Robots()
    async with AsyncExitStack() as stack:
        # As `rcpd serve` does: with so many robots in a process, a full collection takes a second.
        stack.enter_context(collected_at_rest(asyncio.get_running_loop(), lambda: True))
        for number in range(int(first), int(first) + int(count)):
            text = (
                f'{OFF}[transports.zenoh]\ngateway = "r{number}"\ntenant = "t"\n'
                f'connect = ["tcp/127.0.0.1:{port}"]\nsilence = {SILENCE}\n'
                f'[[backends]]\nuse = "robot"\nname = "robot"\ntenant = "t"\n{KEYS}'
            )
            await stack.enter_async_context(serve(parse(text, "bench"), scripted(robots.make)))
        say(ready=len(robots.all), memory=psutil.Process().memory_info().rss)
        async for command in lines():
            match command:
                case ["rate", rate, count]:
                    robots.publish(float(rate), int(count))
                case ["halts"]:
                    say(robots=len(robots.halts), last=max(robots.halts.values(), default=0.0))
                    robots.halts.clear()


# -- the hub -------------------------------------------------------------------------------------


def cpu(process: int | None = None) -> float:
    """CPU seconds of a process, or of this one, all threads."""
    times = psutil.Process(process).cpu_times()
    return times.user + times.system


def memory() -> int:
    """Resident bytes."""
    gc.collect()
    return psutil.Process().memory_info().rss


class Hub:
    """The hub under load, and a client in its process."""

    def __init__(self, served, robots: int) -> None:
        from rcp_gateway.testing import MemoryClient
        from rcp_kernel.values import Encoding

        class Sink(MemoryClient):
            """Keeps updates as they are, with the time of their arrival."""

            updates: list[tuple[int, bytes]] = []  # noqa: RUF012 - of the one sink

            def _flush(self) -> None:
                batch = self.connection.outbox.collect()
                now = time.time_ns()
                for data in batch:
                    if data.startswith(b"\xa4type\xa6update", 1):
                        self.updates.append((now, data))
                    else:
                        self.received(__import__("msgspec").msgpack.decode(data))
                if batch:
                    self.connection.outbox.again()

        self.served, self.robots, self.publishers = served, robots, Publishers()
        self.new_sink = lambda: Sink(served.server.client_api, KEY, Encoding.MSGPACK)
        self.sink = self.new_sink()
        self.sinks = [self.sink]
        self.subscribed: list[tuple[Sink, str]] = []

    async def known(self) -> int:
        """Return how many robots are declared."""
        fleets = [one.backend for one in self.served.lives if one.kind == "fleet"]
        return sum(one.ready for fleet in fleets for one in fleet.gateways.values())

    def own(self, rate: float, count: int) -> list[str]:
        """Publish as many poses from a backend of the hub itself, and return their paths."""
        from rcp_kernel.model import Resource
        from rcp_kernel.types import PoseStamped

        host = next(one.backend.host for one in self.served.lives if one.kind == "own")
        names = [f"sensor/own/pose{number}" for number in range(count)]
        for name in names:
            host.declare(Resource(name=name, description="Pose.", value=PoseStamped))
        self.publishers.run([(host, name) for name in names], rate)
        return [f"/tenant/t/{name}" for name in names]

    async def discover(self) -> None:
        """Discover everything as a client."""
        begun, spent = time.perf_counter(), cpu()
        body = {"limit": 1000, "schemas": False}
        count = 0
        while True:
            reply = await self.sink.request("discover", "/tenant/**", body=body, within=120)
            count += len(reply["body"]["resources"])
            if "cursor" not in reply["body"]:
                took = round(time.perf_counter() - begun, 2)
                say(resources=count, seconds=took, cpu=round(cpu() - spent, 2))
                return
            body["cursor"] = reply["body"]["cursor"]

    async def links(self) -> None:
        """List the links as `rcpctl fleet` does."""
        begun, spent = time.perf_counter(), cpu()
        rows: list[dict] = []
        for type_, body in (("discover", {"limit": 1000, "schemas": False}), ("read", {})):
            reply = await self.sink.request(type_, "/tenant/*/sensor/**/link", body=body, within=60)
            rows = reply["body"]
        took = round(time.perf_counter() - begun, 3)
        say(links=len(rows), seconds=took, cpu=round(cpu() - spent, 3))

    async def metrics(self) -> None:
        """Write `/metrics`, in its steps."""
        steps, spent = self.served.server.client_api.metrics(self.sink.connection.session), cpu()
        longest, text = 0.0, None
        while text is None:
            begun = time.perf_counter()
            try:
                next(steps)
            except StopIteration as end:
                text = end.value
            longest = max(longest, time.perf_counter() - begun)
        series = sum(not line.startswith(b"#") for line in text.splitlines())
        say(series=series, cpu=round(cpu() - spent, 3), longest_step_ms=round(longest * 1e3, 2))

    async def subscribe(self, paths: list[str]) -> None:
        """Subscribe to poses with every client."""
        body = {"paths": paths[1:], "qos": {"depth": 64}}
        for sink in self.sinks:
            reply = await sink.request("subscribe", paths[0], body=body, within=60)
            assert reply["status"] == "completed", reply
            self.subscribed.append((sink, reply["body"]["subscription"]))

    async def unsubscribe(self) -> None:
        """End the subscriptions."""
        while self.subscribed:
            sink, id_ = self.subscribed.pop()
            await sink.request("unsubscribe", body={"subscription": id_}, within=60)

    async def flow(self, seconds: float) -> dict[str, float]:
        """Take updates for a while."""
        import msgspec

        from rcp_kernel.clock import parse_time

        updates = self.sink.updates
        updates.clear()
        begun, spent = time.perf_counter(), cpu()
        await asyncio.sleep(seconds)
        spent, took, got = cpu() - spent, time.perf_counter() - begun, list(updates)
        updates.clear()  # they are no memory of the hub
        decoder = msgspec.msgpack.Decoder(msgspec.defstruct("Update", [("timestamp", str)]))
        ages = sorted((now - parse_time(decoder.decode(one).timestamp)) / 1e6 for now, one in got)
        if not ages:
            return {"updates": 0}
        return {
            "updates": len(ages),
            "rate": round(len(ages) / took),
            "p50_ms": round(statistics.median(ages), 2),
            "p99_ms": round(ages[len(ages) * 99 // 100], 2),
            "cpu": round(spent / took, 3),
            "per_cpu_s": round(len(ages) / spent),
        }


async def serve_hub(port: str, count: str) -> None:
    """Run the hub, and do as the parent says."""
    from rcp_fleet import rcp_backends
    from rcp_gateway.testing import ScriptedRobot, scripted, serve
    from rcp_kernel.config.file import parse
    from rcpd.garbage import collected_at_rest

    robots = int(count)
    text = (
        f'{OFF}[[backends]]\nuse = "fleet"\nname = "fleet"\ntenant = "t"\nhub = "h1"\n'
        f'connect = ["tcp/127.0.0.1:{port}"]\ntoken = "{KEY}"\n'
        f"silence = {SILENCE}\nconnect_timeout = {SILENCE}\n"
        f'[[backends]]\nuse = "own"\nname = "own"\ntenant = "t"\n{LIMITS}{KEYS}'
    )
    import zenoh  # noqa: F401 - its memory is not that of the robots

    from rcp_fleet import backend

    before, begun, spent = 0, 0.0, 0.0

    class Started(backend.FleetBackend):
        """Notes when it begins."""

        def __init__(self, *arguments) -> None:
            nonlocal before, begun, spent
            before, begun, spent = memory(), time.perf_counter(), cpu()
            super().__init__(*arguments)

    backend.FleetBackend = Started
    async with AsyncExitStack() as stack:
        # As `rcpd serve` does.
        stack.enter_context(collected_at_rest(asyncio.get_running_loop(), lambda: True))
        enter = stack.enter_async_context
        own = scripted(ScriptedRobot, "own")
        served = await enter(serve(parse(text, "bench"), *rcp_backends(), own))
        hub = Hub(served, robots)
        while (known := await hub.known()) < robots:  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0.02)
        took = time.perf_counter() - begun
        say(known=known, seconds=round(took, 2), cpu=round(cpu() - spent, 2))
        say(memory_per_robot=round((memory() - before) / robots / 1000, 1))
        async for command in lines():
            match command:
                case ["discover"]:
                    await hub.discover()
                case ["links"]:
                    await hub.links()
                case ["metrics"]:
                    await hub.metrics()
                case ["subscribe", *names]:
                    await hub.subscribe([f"/tenant/t/sensor/{one}/pose" for one in names])
                    say(subscribed=len(names))
                case ["clients", count]:
                    hub.sinks[1:] = [hub.new_sink() for _ in range(int(count) - 1)]
                    say(clients=len(hub.sinks))
                case ["own", rate, many]:
                    await hub.subscribe(hub.own(float(rate), int(many)))
                    say(subscribed=int(many))
                case ["unsubscribe"]:
                    await hub.unsubscribe()
                    hub.publishers.run([], 0.0)
                    say(unsubscribed=True)
                case ["flow", seconds]:
                    say(**await hub.flow(float(seconds)))
                case ["memory"]:
                    say(memory_per_robot=round((memory() - before) / robots / 1000, 1))
                case ["reset"]:
                    await hub.sink.request("execute", "/system/estop", body={"reset": True})
                    say(reset=True)
                case ["stop"]:
                    begun, at, spent = time.perf_counter(), time.time(), cpu()
                    reply = await hub.sink.request("execute", "/system/estop", body={}, within=120)
                    say(
                        status=reply["status"], at=at,
                        confirmed=round(time.perf_counter() - begun, 2), cpu=round(cpu() - spent, 2),
                        error=str(reply.get("error", ""))[:300],
                    )  # fmt: skip


# -- the whole -----------------------------------------------------------------------------------


class Child:
    """A process that answers each command with a line."""

    def __init__(self, *arguments: object) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def send(self, command: str) -> None:
        """Send a command that is not answered."""
        assert self.process.stdin
        print(command, file=self.process.stdin, flush=True)

    def line(self) -> dict:
        """Read an answer."""
        assert self.process.stdout
        while (text := self.process.stdout.readline()) and not text.startswith("{"):
            pass
        if not text:
            sys.exit(f"a process ended with {self.process.wait()}, and nothing was measured")
        return json.loads(text)

    def ask(self, command: str) -> dict:
        """Send a command and read its answer."""
        self.send(command)
        return self.line()


def report(what: str, facts: object) -> None:
    """Print a line, with the load of the machine."""
    print(f"  {what:34} {facts}  (load {os.getloadavg()[0]:.1f})", flush=True)


class Spending:
    """CPU seconds of the processes since the last look: they share the machine."""

    def __init__(self, router: Child, fleet: list[Child], hub: Child) -> None:
        self._groups = {"hub": [hub], "router": [router], "robots": fleet}
        self._last = self._total()
        self._since = time.perf_counter()

    def _total(self) -> dict[str, float]:
        return {
            name: sum(cpu(one.process.pid) for one in group) for name, group in self._groups.items()
        }

    def look(self) -> dict[str, float]:
        """Return what was spent, and in what time."""
        total, moment = self._total(), time.perf_counter()
        spent = {name: round(total[name] - self._last[name], 2) for name in total}
        spent["seconds"] = round(moment - self._since, 2)
        self._last, self._since = total, moment
        return spent


def compare(hub: Child, fleet: list[Child], names: list[str], spending: Spending) -> None:
    """Measure updates through the hub beside as many that a backend of the hub publishes."""
    for clients in CLIENTS:
        hub.ask(f"clients {clients}")
        found = []
        for what in ("of robots", "of its own"):
            if what == "of robots":
                for child in fleet:
                    child.send(f"rate 100 {len(names) // len(fleet)}")
                hub.ask(f"subscribe {' '.join(names)}")
            else:
                hub.ask(f"own 100 {len(names)}")
            time.sleep(1)
            spending.look()
            flow = hub.ask(f"flow {SECONDS}")
            found.append(flow["per_cpu_s"])
            report(f"{len(names)} poses {what}, 100 Hz, to {clients}", flow)
            report("  CPU s", spending.look())
            hub.ask("unsubscribe")
            for child in fleet:
                child.send("rate 0 0")
        report("  through the hub / of its own", round(found[0] / found[1], 2))
    hub.ask("clients 1")


def stop(hub: Child, fleet: list[Child], spending: Spending, what: str) -> None:
    """Stop all robots, each of which publishes at 10 Hz."""
    spending.look()
    stopped = hub.ask("stop")
    spent = spending.look()
    halts = [child.ask("halts") for child in fleet]
    last = max(one["last"] for one in halts) - stopped["at"]
    report(f"e-stop, {what}", stopped)
    report("  CPU s", spent)
    report("  last robot halted after s", (sum(one["robots"] for one in halts), round(last, 2)))


def main(robots: int, processes: int) -> None:
    """Measure everything once."""
    quiet()
    router = Child("router")
    port = router.line()["port"]
    share = robots // processes
    own = psutil.Process(router.process.pid)
    before = own.memory_info().rss
    begun = time.perf_counter()
    fleet = [Child("robots", port, i * share, share) for i in range(processes)]
    for child in fleet:
        report("robots of one process", child.line())
    report("robots are up after, s", round(time.perf_counter() - begun, 1))
    time.sleep(3)
    hub = Child("hub", port, robots)
    spending = Spending(router, fleet, hub)
    report("the hub knows all", hub.line())
    report("  CPU s", spending.look())
    report("kB of the hub a robot", hub.line())
    report("kB of the router a robot", round((own.memory_info().rss - before) / robots / 1000, 1))
    spending.look()
    report("a client discovers all", hub.ask("discover"))
    report("  CPU s", spending.look())
    report("kB of the hub a robot", hub.ask("memory"))
    report("links are listed", hub.ask("links"))
    report("metrics are written", hub.ask("metrics"))
    near = min(NEAR, robots) // processes
    names = [f"r{p * share + i}" for p in range(processes) for i in range(near)]
    for child in fleet:
        child.send(f"rate 10 {near}")
    report("subscribed", hub.ask(f"subscribe {' '.join(names)}"))
    time.sleep(2)
    spending.look()
    report("100 robots, 10 Hz", hub.ask(f"flow {SECONDS}"))
    report("  CPU s", spending.look())
    hub.ask("unsubscribe")
    compare(hub, fleet, names, spending)
    for child in fleet:
        child.send(f"rate 10 {share}")
    report("subscribed", hub.ask(f"subscribe {' '.join(names)}"))
    time.sleep(1)
    stop(hub, fleet, spending, "100 poses looked at")
    hub.ask("reset")
    hub.ask("unsubscribe")
    every = [f"r{i}" for i in range(share * processes)]
    report("subscribed", hub.ask(f"subscribe {' '.join(every)}"))
    time.sleep(3)
    spending.look()
    report("all robots, 10 Hz", hub.ask(f"flow {SECONDS}"))
    report("  CPU s", spending.look())
    report("kB of the hub a robot", hub.ask("memory"))
    stop(hub, fleet, spending, "all poses looked at")
    for child in (hub, *fleet, router):
        child.process.kill()


def serve_router() -> None:
    """Be the router."""
    import socket

    import zenoh

    from rcp_zenoh.session import configuration

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    config = configuration("router", listen=[f"tcp/127.0.0.1:{port}"], silence=SILENCE)
    with zenoh.open(config):
        say(port=port)
        sys.stdin.readline()


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["router"]:
            quiet()
            serve_router()
        case ["robots", *arguments]:
            quiet()
            uvloop.run(serve_robots(*arguments))
        case ["hub", *arguments]:
            quiet()
            uvloop.run(serve_hub(*arguments))
        case [*numbers]:
            main(*(*map(int, numbers), *(ROBOTS, PROCESSES)[len(numbers) :]))
