"""What a well-behaved client notices, in a process of its own: prints the worst of each.

Run: python watch.py URL SECONDS
"""

from __future__ import annotations

import asyncio
import gc
import json
import sys
import time
from collections.abc import Awaitable, Callable

import httpx
import websockets

KEY = "Bearer guard-against-attack"
_PAUSE = 0.03  # s between two e-stops, two questions for health
_REPLY = 20.0  # s for anything
ESTOP = "/system/estop"


async def _repeated(until: float, ask: Callable[[], Awaitable[float]]) -> list[float]:
    took = [await ask()]
    while time.perf_counter() < until:
        await asyncio.sleep(_PAUSE)
        took.append(await ask())
    return took


async def stops(url: str, until: float) -> list[float]:
    """Time e-stops of the spare robot, each reset afterwards."""
    async with websockets.connect(
        url, additional_headers={"Authorization": KEY}, subprotocols=["rcp.v1.json"]
    ) as socket:

        async def ask(**body: object) -> float:
            began = time.perf_counter()
            envelope = {"type": "execute", "id": f"{began}", "path": ESTOP, "body": body}
            await socket.send(json.dumps(envelope))
            async with asyncio.timeout(_REPLY):
                reply = json.loads(await socket.recv())
            if reply["status"] != "completed":
                raise RuntimeError(reply)
            return time.perf_counter() - began

        async def stop() -> float:
            took = await ask(scope="spare")
            await ask(scope="spare", reset=True)
            return took

        return await _repeated(until, stop)


async def gaps(url: str, until: float) -> list[float]:
    """Time the gaps between poses."""
    async with websockets.connect(
        url, additional_headers={"Authorization": KEY}, subprotocols=["rcp.v1.json"]
    ) as socket:
        await socket.send(json.dumps({"type": "subscribe", "id": "p", "path": "/sensor/pose"}))
        await socket.recv()
        await socket.recv()
        last, found = time.perf_counter(), list[float]()
        while not found or last < until:
            async with asyncio.timeout(_REPLY):
                await socket.recv()
            moment = time.perf_counter()
            found.append(moment - last)
            last = moment
        return found


async def health(url: str, until: float) -> list[float]:
    """Time answers of `/healthz`."""
    async with httpx.AsyncClient(base_url=url, timeout=_REPLY) as client:

        async def ask() -> float:
            began = time.perf_counter()
            (await client.get("/healthz")).raise_for_status()
            return time.perf_counter() - began

        return await _repeated(until, ask)


async def main(url: str, seconds: float) -> None:
    """Print the worst of everything in milliseconds."""
    place, headers = f"{url}/rcp/v1/context/param/turn", {"authorization": KEY}
    socket = url.replace("http", "ws", 1) + "/rcp/v1/ws"
    async with httpx.AsyncClient(timeout=_REPLY, headers=headers) as client:
        (await client.put(place, json=0.0)).raise_for_status()
        until = time.perf_counter() + seconds
        found = await asyncio.gather(stops(socket, until), gaps(socket, until), health(url, until))
        reply = (await client.get(place, params={"fresh": "true"})).raise_for_status().json()
        turn = reply["body"]
    sys.stdout.write(json.dumps([round(one * 1000, 1) for one in (*map(max, found), turn)]))


if __name__ == "__main__":
    gc.disable()  # the gateway's time is measured, not this process's
    asyncio.run(main(sys.argv[1], float(sys.argv[2])))
