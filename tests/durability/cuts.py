"""Cut the link of a robot again and again, and count what was executed: run by test_cuts.py.

A hub and a robot's gateway in one process, with a TCP proxy between the robot and the router, which
breaks connections, refuses new ones for a while, freezes old ones and lets their bytes through after
those of new ones, and slows. Meanwhile clients of the hub send commands with feedback, writes and
plans, and a client of the robot itself, over a link of its own, holds a lease and a reliable
subscription. The two contend for another lease, and never both hold it. Several such pairs run
at once, since nearly all of it is waiting. By hand: `python tests/durability/cuts.py CUTS SEED PAIRS`.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
from collections import Counter
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec

sys.path.insert(0, str(Path(__file__).parents[1]))

from ports import free_port
from rcp_client.address import Address
from rcp_client.client import Client
from rcp_client.messages import Codec, Notice
from rcp_client.settings import Settings
from rcp_fleet.link import FleetLink, FleetLinks
from rcp_fleet.link_names import LinkNames
from rcp_gateway.log import configure
from rcp_gateway.testing import OPERATOR, MemoryClient, ScriptedRobot, serve
from rcp_kernel.clock import now, parse_time
from rcp_kernel.config.file import parse
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import quantity
from rcp_zenoh.session import configuration, opened
from rcp_zenoh.statistics import LinkStatistics
from transports.cable import Cable

BOUND = 60.0  # s that anything may take to come right after a cut
SILENCE = 1.0  # s
FINAL = frozenset(("completed", "failed", "rejected", "cancelled"))
COMMANDERS = 4, 2  # of one pair, and of each of several
REST = 0.02  # s between two leases of a pair of several: they share the machine
TTL = 2.0  # s of the lease that both sides want: some expire during a cut

_OFF = "[transports]\nasgi = false\nhttp = false\nws = false\nsse = false\n"
_KEYS = f'[[keys]]\nname = "operator"\nrole = "operator"\nkey = "{OPERATOR}"\n'
HUB = (
    f'{_OFF}[[backends]]\nuse = "fleet"\nname = "fleet"\ntenant = "alpha"\nhub = "h1"\n'
    f'listen = ["tcp/127.0.0.1:%d"]\ntoken = "{OPERATOR}"\nsilence = {SILENCE}\n'
    f"connect_timeout = 2.0\n{_KEYS}"
)
ROBOT = (
    f'{_OFF}[transports.zenoh]\ngateway = "r7"\ntenant = "alpha"\nsilence = {SILENCE}\n'
    f'connect = ["tcp/127.0.0.1:%d"]\n[[backends]]\nuse = "robot"\ntenant = "alpha"\n{_KEYS}'
)


class Robot:
    """Counts what it executes, by the mark that each request has."""

    def __init__(self) -> None:
        self.ran: Counter[str] = Counter()

    async def go(self, mark: Any, progress: Progress) -> Any:
        """Take a while, and tell of it."""
        self.ran[mark] += 1
        for step in range(random.randrange(1, 6)):
            progress(mark, fraction=step / 6)
            await asyncio.sleep(random.uniform(0, 0.1))
        return mark

    async def run(self, mark: Any, _progress: Progress) -> Any:
        """Be done at once."""
        self.ran[mark] += 1
        return mark

    async def take(self, mark: Any) -> Any:
        """Take a value."""
        self.ran[mark] += 1
        return mark

    @asynccontextmanager
    async def opened(self, _config: Any, host: Host) -> AsyncGenerator[ScriptedRobot]:
        """Be a backend."""
        text: dict[str, Any] = {"input": str, "output": str}
        robot = ScriptedRobot(
            host,
            Resource(
                name="action/go", description="Goes.", feedback=str, policy="parallel", **text
            ),
            Resource(name="service/run", description="Runs.", **text),
            Resource(name="service/own", description="Runs under a lease.", **text),
            Resource(name="service/ours", description="Both sides want it.", **text),
            Resource(name="param/label", description="A label.", value=str),
            Resource(name="sensor/level", description="A level.", value=quantity("m"), live=True),
            behaviours={
                "action/go": self.go,
                "service/run": self.run,
                "service/own": self.run,
                "service/ours": self.run,
            },
        )
        robot.takes["param/label"] = self.take
        measuring = asyncio.create_task(_measure(robot))
        try:
            yield robot
        finally:
            measuring.cancel()


async def _measure(robot: ScriptedRobot) -> None:
    for number in range(1_000_000):
        robot.measure("sensor/level", float(number))
        await asyncio.sleep(0.01)


class Campaign:
    """What was sent, what came back, and what must hold of it."""

    def __init__(self, *, alone: bool) -> None:
        self.robot = Robot()
        self.commanders = COMMANDERS[not alone]
        self._rest = 0.0 if alone else REST
        self.counts: Counter[str] = Counter()
        self.outcomes: dict[str, list[str]] = {}
        self.seen: list[int] = []
        self.gaps: list[tuple[int, int]] = []
        self.fresh = asyncio.Event()
        self.hub_holds = 0
        """Until when the hub's lease on what both sides want holds, ns; 0: it has none."""
        self.over = False

    async def command(self, client: MemoryClient, name: str) -> None:
        """Send requests of all kinds, one after the other, each with a mark."""
        kinds = ("action/r7/go", "service/r7/run", "param/r7/label", "plan")
        for number in range(1_000_000):
            if self.over:
                return
            mark, kind = f"{name}-{number}", kinds[number % len(kinds)]
            replies = await client.replies(await client.send(_request(kind, mark)), BOUND)
            self.outcomes[mark] = [reply["status"] for reply in replies]
            self.counts[f"{kind} {replies[-1]['status']}"] += 1
            if replies[-1]["status"] != "completed":
                self.counts["error " + replies[-1]["error"]["code"]] += 1
                await asyncio.sleep(0.05)

    async def listen(self, client: Client) -> None:
        """Receive every sample, or the name of the gap."""
        level = "/tenant/alpha/sensor/level"
        async for update in client.subscribe(level, reliable=True, qos={"depth": 4000}):
            self.seen.append(update.seq)
            self.fresh.set()
            if update.dropped:
                self.gaps.append((update.seq - update.dropped, update.seq - 1))

    def noticed(self, notice: Notice) -> None:
        """Take down the gaps that the gateway names."""
        self.counts[f"notice {notice.code}"] += 1
        if notice.code == "gap" and "first" in notice.facts:
            self.gaps.append((notice.facts["first"], notice.facts["last"]))

    async def hold(self, client: Client) -> None:
        """Hold a lease, and execute under it."""
        for number in range(1_000_000):
            mark = f"own-{number}"
            try:
                async with client.lease("/tenant/alpha/service/own", ttl=30.0):
                    body = await client.execute("/tenant/alpha/service/own", mark, deadline=BOUND)
                    assert body == mark
                    self.outcomes[mark] = ["completed"]
                    self.counts["under a lease"] += 1
            except RcpError as error:
                self.outcomes[mark] = ["failed"]
                self.counts[f"under a lease {error.code}"] += 1
            if self.over:
                return
            await asyncio.sleep(self._rest)

    async def contend(self, client: Client) -> None:
        """Acquire at the robot what somebody at the hub wants too, again and again."""
        path = "/tenant/alpha/service/ours"
        while not self.over:
            try:
                async with client.lease(path, ttl=TTL):
                    assert now() > self.hub_holds, "the hub and the robot both granted a lease"
                    self.counts["robot's lease"] += 1
                    await asyncio.sleep(random.uniform(0, 0.2))
            except RcpError as error:
                self.counts[f"robot's lease {error.code}"] += 1
            await asyncio.sleep(random.uniform(0.05, 0.3))

    async def contend_at_hub(self, client: MemoryClient) -> None:
        """Acquire and use at the hub what somebody at the robot wants too, again and again."""
        path = "/tenant/alpha/service/r7/ours"
        for number in range(1_000_000):
            if self.over:
                return
            got = await self._lease(client, {"do": "acquire", "scope": path, "ttl": TTL})
            if got["status"] == "completed":
                self.hub_holds = parse_time(got["body"]["expires"])
                mark = f"ours-{number}"
                sent = {"type": "execute", "path": path, "body": mark, "idempotency_key": mark}
                replies = await client.replies(await client.send(sent), BOUND)
                self.outcomes[mark] = [reply["status"] for reply in replies]
                self.hub_holds = 0
                await self._lease(client, {"do": "release", "scope": path})
            await asyncio.sleep(random.uniform(0.05, 0.3))

    async def _lease(self, client: MemoryClient, body: dict[str, Any]) -> dict[str, Any]:
        sent = {"type": "execute", "path": "/system/leases", "body": body}
        (reply,) = await client.replies(await client.send(sent), BOUND)
        code = reply["error"]["code"] if reply.get("error") else reply["status"]
        self.counts[f"hub's lease {body['do']} {code}"] += 1
        return reply

    def check(self) -> None:
        """Raise AssertionError with what is wrong."""
        for mark, statuses in self.outcomes.items():
            ran = self.robot.ran[mark]
            assert sum(status in FINAL for status in statuses) == 1, (mark, statuses)
            assert ran <= 1, f"{mark} ran {ran} times"
            if statuses[-1] == "completed":
                assert ran == 1, f"{mark} completed and never ran"
            if statuses[-1] == "rejected":
                assert ran == 0, f"{mark} was rejected and ran"
        assert not self.counts["error estop_active"], "a cut stopped the robot"
        assert len(set(self.seen)) == len(self.seen), "a sample came twice"
        missing = set(range(self.seen[0], self.seen[-1])) - set(self.seen)
        named = {number for first, last in self.gaps for number in range(first, last + 1)}
        assert missing <= named, f"missing without a gap: {sorted(missing - named)[:20]}"
        self.counts["samples"], self.counts["samples in gaps"] = len(self.seen), len(missing)
        self.counts["commands"] = len(self.outcomes)


def _request(kind: str, mark: str) -> dict[str, Any]:
    if kind == "plan":
        path = "/tenant/alpha/service/r7/run"
        steps = [{"do": "execute", "path": path, "value": mark}]
        return {"type": "execute", "path": "/system/plans", "body": {"steps": steps}}
    type_ = "write" if kind.startswith("param") else "execute"
    path = f"/tenant/alpha/{kind}"
    return {"type": type_, "path": path, "body": mark, "idempotency_key": mark, "deadline": 30.0}


def _cuts(cable: Cable) -> dict[str, Callable[[], Awaitable[None]]]:
    async def cut() -> None:
        cable.cut()

    async def part() -> None:
        cable.part()
        await asyncio.sleep(random.uniform(0.1, 2 * SILENCE))
        cable.mend()

    async def freeze() -> None:
        cable.freeze()

    async def reorder() -> None:
        cable.freeze()
        await asyncio.sleep(random.uniform(0.1, 3 * SILENCE))
        cable.mend()

    async def slow() -> None:
        cable.slow(random.choice((5_000, 50_000)))
        await asyncio.sleep(random.uniform(0.1, 2 * SILENCE))
        cable.mend()

    return {"cut": cut, "parted": part, "frozen": freeze, "reordered": reorder, "slowed": slow}


async def _until(holds: Callable[[], bool], what: str) -> None:
    try:
        async with asyncio.timeout(BOUND):
            while not holds():  # noqa: ASYNC110 - a link has no event for it
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"{what}: not within {BOUND} s") from None


def _no_feed(_id: str | None) -> None:
    return None


@asynccontextmanager
async def _own_client(port: int, campaign: Campaign) -> AsyncGenerator[Client]:
    """Connect to the robot's gateway as another hub does."""
    config = configuration("client", connect=[f"tcp/127.0.0.1:{port}"], silence=SILENCE)
    async with AsyncExitStack() as stack:
        session = await stack.enter_async_context(opened(config, patient=False))
        names = LinkNames(asyncio.get_running_loop().time)
        links = FleetLinks(session, names, "alpha", "h2", SILENCE)
        await stack.enter_async_context(links.receiving())

        async def dial(codec: Codec, received: Any, lost: Any) -> FleetLink:
            return links.open("r7", LinkStatistics({}), _no_feed, codec, received, lost)

        settings = Settings(
            address=Address.parse("fleet"),
            token=OPERATOR,
            connect_timeout=2.0,
            patience=None,
            longest_pause=1.0,
            on_notice=campaign.noticed,
            dial=dial,
        )
        async with Client(settings) as client:
            yield client


async def campaign(cuts: int, *, alone: bool) -> Counter[str]:
    """Cut so many times, and check everything."""
    one, port = Campaign(alone=alone), free_port()
    kind = BackendKind("robot", msgspec.Struct, one.robot.opened)
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        hub = await enter(serve(parse(HUB % port, "hub")))
        cable = await enter(Cable(port).laid())
        robot = await enter(serve(parse(ROBOT % cable.port, "robot"), kind))

        await _until(lambda: hub.supervisor.backend is not None, "the hub is open")
        fleet = getattr(hub.supervisor.backend, "inner", None)
        gateways: dict[str, Any] = getattr(fleet, "gateways")  # noqa: B009 - of another type
        await _until(lambda: "r7" in gateways and gateways["r7"].ready, "the robot is there")
        own = await enter(_own_client(port, one))
        *clients, rival = (hub.client(OPERATOR) for _ in range(one.commanders + 1))
        for client in (*clients, rival):
            stack.push_async_callback(client.close)
        listening = asyncio.create_task(one.listen(own))
        tasks = [
            asyncio.create_task(one.command(client, f"c{place}"))
            for place, client in enumerate(clients)
        ]
        tasks.append(asyncio.create_task(one.hold(own)))
        tasks.append(asyncio.create_task(one.contend(own)))
        tasks.append(asyncio.create_task(one.contend_at_hub(rival)))
        kinds = _cuts(cable)
        for number in range(cuts):
            name = list(kinds)[number % len(kinds)]
            await asyncio.sleep(random.uniform(0.05, 0.5))
            began = asyncio.get_running_loop().time()
            await kinds[name]()
            one.counts[name] += 1
            await _until(lambda: gateways["r7"].ready and own.connected, f"back after {name}")
            one.fresh.clear()
            await _until(one.fresh.is_set, f"samples after {name}")
            took = round(1000 * (asyncio.get_running_loop().time() - began))
            one.counts[f"longest {name}, ms"] = max(one.counts[f"longest {name}, ms"], took)
        one.over = True
        async with asyncio.timeout(2 * BOUND):
            await asyncio.gather(*tasks)
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)
        link = robot.server.gateway.status.transports[0]["links"]
        for row in link:
            one.counts["links"] += row["links"]
            one.counts["links ended by a loss"] += row["lost"]
    one.check()
    return one.counts


async def campaigns(cuts: int, pairs: int) -> Counter[str]:
    """Share the cuts among several pairs of hub and robot."""
    shares = (campaign(cuts // pairs, alone=pairs == 1) for _ in range(pairs))
    total: Counter[str] = Counter()
    for counts in await asyncio.gather(*shares):
        for name, count in counts.items():
            longest = name.startswith("longest")
            total[name] = max(total[name], count) if longest else total[name] + count
    return total


if __name__ == "__main__":
    configure("error", "json")
    random.seed(int(sys.argv[2]))
    found = asyncio.run(campaigns(int(sys.argv[1]), int(sys.argv[3])))
    print(json.dumps(found))  # noqa: T201 - the test reads it
