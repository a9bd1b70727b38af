"""Kill a gateway at each place that a request with a key passes, then send it again: run by test_keys.py.

Each life of the gateway is a fork of this process, as in crash.py, whose robot writes down what it is told.
By hand: `python tests/durability/keys.py FOLDER write|execute`.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any, NamedTuple

from crash import FINAL, Journal, keyed, lines, prepared

from rcp_gateway.log import Recent, configure
from rcp_gateway.server import Server, running
from rcp_kernel.values import Encoding
from rcp_requests.idempotency import Keys
from rcp_store import store_writer
from rcp_store.disk_store import DiskStore

LIVES = 3
REQUESTS = {
    "write": keyed({"type": "write", "path": "/param/label"}, "once"),
    "execute": keyed({"type": "execute", "path": "/service/run"}, "once"),
}


def die(*_: Any, **__: Any) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


class Place(NamedTuple):
    """A place on the way of a request: before or after a call, of those that come in its phase."""

    owner: Any
    name: str
    ends: bool
    """Whether the call has ended."""
    phase: str
    """What has happened to the request: it was `sent`, its key was `noted`, its outcome was `settled`."""


PLACES = {
    "before the key is noted": Place(Keys, "note", False, "sent"),
    "when the key is noted": Place(Keys, "note", True, "sent"),
    "before the key is handed over": Place(DiskStore, "_hand_over", False, "noted"),
    "before the key is committed": Place(store_writer, "commit", False, "noted"),
    "when the key is committed": Place(store_writer, "commit", True, "noted"),
    "before the gateway hears of it": Place(DiskStore, "_written", False, "noted"),
    "before the robot is told": Place(Journal, "write", False, "noted"),
    "when the robot is told": Place(Journal, "write", True, "noted"),
    "before the outcome is noted": Place(Keys, "settle", False, "noted"),
    "when the outcome is noted": Place(Keys, "settle", True, "noted"),
    "before the outcome is handed over": Place(DiskStore, "_hand_over", False, "settled"),
    "before the outcome is committed": Place(store_writer, "commit", False, "settled"),
    "when the outcome is committed": Place(store_writer, "commit", True, "settled"),
    "before the gateway hears of that": Place(DiskStore, "_written", False, "settled"),
    "before the client is told": Place(Journal, "write", False, "settled"),
    "when the client is told": Place(Journal, "write", True, "settled"),
}
"""Where the first life ends, in the order in which a request comes past."""

phase = "waiting"


def mine(place: Place) -> None:
    """Have this process die when it comes past a place."""
    real = getattr(place.owner, place.name)

    def instead(*args: Any, **kwargs: Any) -> Any:
        due = phase == place.phase
        if due and not place.ends:
            die()
        result = real(*args, **kwargs)
        if due:
            die()
        return result

    setattr(place.owner, place.name, instead)


def follow(owner: Any, name: str, then: str) -> None:
    """Have the phase change when a call has ended."""
    real = getattr(owner, name)

    def instead(*args: Any, **kwargs: Any) -> Any:
        global phase  # noqa: PLW0603 - of the whole process
        result = real(*args, **kwargs)
        phase = then
        return result

    setattr(owner, name, instead)


def live(folder: Path, life: int, envelope: dict[str, Any], place: str) -> None:
    """Be a gateway that is sent one request, until it is answered or killed."""
    configure("error", "json")
    follow(Keys, "note", "noted")
    follow(Keys, "settle", "settled")
    if life == 0:
        mine(PLACES[place])

    async def serve() -> None:
        async with running(prepared(folder), Recent()) as server:
            await answered(server)

    async def answered(server: Server) -> None:
        global phase  # noqa: PLW0603 - of the whole process
        done, told = asyncio.Event(), Journal(folder / "told")
        principal = server.client_api.authenticate("operator-operator")

        def flush() -> None:
            for data in connection.outbox.collect():
                reply = json.loads(data)
                if reply["status"] in FINAL:
                    told.write([life, reply["status"], reply.get("error", {}).get("code")])
                    done.set()

        connection = server.client_api.connect(principal, Encoding.JSON, flush)
        idle = asyncio.Event()
        server.gateway.store.settled(idle.set)
        await idle.wait()  # or the thread would die of what it wrote before
        phase = "sent"
        connection.receive(json.dumps({"id": f"{life}", **envelope}).encode())
        await done.wait()
        die()

    asyncio.run(serve())


def lived(folder: Path, kind: str, place: str) -> dict[str, Any]:
    """Live three times, the first life up to the place; return what the robot and the clients saw."""
    folder.mkdir()
    for life in range(LIVES):
        pid = os.fork()
        if pid == 0:
            try:
                live(folder, life, REQUESTS[kind], place)
            finally:
                os._exit(1)
        _, status = os.waitpid(pid, 0)
        assert os.WIFSIGNALED(status), f"{place}: life {life} ended by itself"
    told = {life: [status, code] for life, status, code in lines(folder / "told")}
    ran = list(lines(folder / "ran"))
    return {"ran": len(ran), "told": [told.get(life) for life in range(LIVES)]}


def main(folder: Path, kind: str) -> None:
    found = {p: lived(folder / f"{n}", kind, p) for n, p in enumerate(PLACES)}
    print(json.dumps(found))  # noqa: T201 - the test reads it


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
