"""A small fleet manager: sends ten robots through a depot by VDA 5050, without two on one lane.

Run: python examples/depot/master.py [--broker HOST:PORT] [--orders N]. The depot is a grid of nodes, 3 m
apart. A robot reserves every node of its way before it is sent, and gives each back when the next one is
reached; who finds no free way waits. It needs `pip install aiomqtt`, and nothing of the gateway.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import random
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import aiomqtt

COLUMNS, ROWS, APART = 5, 3, 3.0  # of the grid, and m
ROBOTS = [f"amr{n}" for n in range(10)]
AGAIN = 2.0  # s after which an order that no state shows is sent again
Node = tuple[int, int]


class Depot:
    """Who has reserved which node; a lane belongs to whoever has both of its ends."""

    def __init__(self) -> None:
        self.holders: dict[Node, str] = {}
        self._freed = asyncio.Condition()

    def way(self, robot: str, start: Node, goal: Node) -> list[Node] | None:
        """Return the shortest way over free nodes; None: there is none now."""
        before: dict[Node, Node] = {start: start}
        line = deque([start])
        while line and goal not in before:
            column, row = node = line.popleft()
            for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                beside = column + step[0], row + step[1]
                inside = 0 <= beside[0] < COLUMNS and 0 <= beside[1] < ROWS
                if inside and beside not in before and self.holders.get(beside, robot) == robot:
                    before[beside] = node
                    line.append(beside)
        if goal not in before:
            return None
        found = [goal]
        while found[-1] != start:
            found.append(before[found[-1]])
        return found[::-1]

    async def reserve(self, robot: str, start: Node, choice: random.Random) -> list[Node]:
        """Wait for a way to some free node, and reserve it."""
        every = list(itertools.product(range(COLUMNS), range(ROWS)))
        async with self._freed:
            while True:
                free = [node for node in every if node not in self.holders]
                choice.shuffle(free)
                for goal in free:
                    if (way := self.way(robot, start, goal)) is not None:
                        self.holders |= dict.fromkeys(way, robot)
                        return way
                await self._freed.wait()

    async def free(self, nodes: list[Node]) -> None:
        """Give nodes back."""
        async with self._freed:
            for node in nodes:
                del self.holders[node]
            self._freed.notify_all()


class Robot:
    """One robot, by the states that it sends."""

    def __init__(self, client: aiomqtt.Client, serial: str, base: str) -> None:
        self._client, self.serial, self._base = client, serial, f"{base}/{serial}"
        self._headers = itertools.count()
        self._news = asyncio.Condition()
        self.state: dict[str, Any] = {}

    async def hear(self, state: dict[str, Any]) -> None:
        """Take a state."""
        async with self._news:
            self.state = state
            self._news.notify_all()

    async def until(self, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait for a state."""
        async with self._news:
            await self._news.wait_for(lambda: bool(self.state) and holds(self.state))
            return self.state

    async def go(self, order: str, way: list[Node]) -> None:
        """Send an order until the state shows it."""
        message = _order(order, way) | {
            "headerId": next(self._headers),
            "timestamp": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "version": "2.1.0",
            "manufacturer": "example",
            "serialNumber": self.serial,
        }
        while self.state.get("orderId") != order:
            await self._client.publish(f"{self._base}/order", json.dumps(message), qos=1)
            with suppress(TimeoutError):
                async with asyncio.timeout(AGAIN):
                    await self.until(lambda state: state["orderId"] == order)

    async def start(self) -> Node:
        """Return the node at which it stands."""
        state = await self.until(lambda state: "agvPosition" in state)
        position = state["agvPosition"]
        return round(position["x"] / APART), round(position["y"] / APART)


def _name(node: Node) -> str:
    return f"n{node[0]}-{node[1]}"


def _order(order: str, way: list[Node]) -> dict[str, Any]:
    nodes = [
        {
            "nodeId": _name((column, row)),
            "sequenceId": 2 * place,
            "released": True,
            "nodePosition": {"x": column * APART, "y": row * APART, "mapId": "hall"},
            "actions": [],
        }
        for place, (column, row) in enumerate(way)
    ]
    edges = [
        {
            "edgeId": f"{start['nodeId']}_{end['nodeId']}",
            "sequenceId": start["sequenceId"] + 1,
            "released": True,
            "startNodeId": start["nodeId"],
            "endNodeId": end["nodeId"],
            "actions": [],
        }
        for start, end in itertools.pairwise(nodes)
    ]
    return {"orderId": order, "orderUpdateId": 0, "nodes": nodes, "edges": edges}


async def work(robot: Robot, depot: Depot, orders: int, choice: random.Random) -> None:
    """Send a robot about, order after order."""
    here = await robot.start()
    for number in range(orders):
        way = await depot.reserve(robot.serial, here, choice)
        name = f"{robot.serial}-{number}"
        await robot.go(name, way)
        for place in range(1, len(way)):
            ahead = {_name(node) for node in way[place:]}
            state = await robot.until(
                lambda state, name=name, ahead=ahead: (
                    bool(state["errors"])
                    or state["orderId"] != name
                    or state["lastNodeId"] in ahead
                )
            )
            if state["orderId"] != name:  # and nobody knows where it stands between two nodes
                text = "it has lost its order: its gateway was restarted. Look where it stands, then begin anew."
                raise SystemExit(f"{robot.serial}: {text}")
            if state["errors"]:
                raise SystemExit(f"{robot.serial}: {state['errors'][0]['errorDescription']}")
            await depot.free([way[place - 1]])
        here = way[-1]
        print(f"{name}: at {_name(here)}")


async def manage(host: str, port: int, orders: int, depot: Depot | None = None) -> None:
    """Manage the depot until every robot has carried out its orders."""
    depot = depot or Depot()
    async with aiomqtt.Client(host, port) as client:
        base = "uagv/v2/example"
        robots = {serial: Robot(client, serial, base) for serial in ROBOTS}
        await client.subscribe(f"{base}/+/state")

        async def listen() -> None:
            async for message in client.messages:
                robot = robots.get(str(message.topic).split("/")[3])
                if robot is not None and isinstance(message.payload, bytes):
                    await robot.hear(json.loads(message.payload))

        listening = asyncio.create_task(listen())
        try:
            for robot in robots.values():
                depot.holders[await robot.start()] = robot.serial
            choice = random.Random(1)  # noqa: S311 - where to go is no secret
            async with asyncio.TaskGroup() as group:
                for robot in robots.values():
                    group.create_task(work(robot, depot, orders, choice))
        finally:
            listening.cancel()


def main() -> None:
    """Read the command line, and manage."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--broker", default="127.0.0.1:1883")
    parser.add_argument("--orders", type=int, default=5, help="of each robot")
    given = parser.parse_args()
    host, _, port = given.broker.rpartition(":")
    asyncio.run(manage(host, int(port), given.orders))


if __name__ == "__main__":
    main()
