"""What a hub and a robot's gateway of one version say to each other, kept for the versions after it.

Run `python tests/backends/fleet/recording.py` (with `tests` in PYTHONPATH) before a release: it
writes `recorded/<version>.json`, which the tests of later versions use.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Any, Self

import msgspec
import zenoh

from backends.fleet.rig import appears, hub_at, robot_at, serving
from configuration import key
from ports import free_port
from rcp_fleet.link import FleetLink
from rcp_gateway.testing import ADMIN
from rcp_kernel.contract.version import gateway_version
from rcp_zenoh.budget import Allowance
from rcp_zenoh.keys import LinkKeys, alive, links_of, part
from rcp_zenoh.lane import Priority
from rcp_zenoh.pipe import Pipe
from rcp_zenoh.session import configuration, on_loop, opened

__all__ = ["FOLDER", "RecordedGateway", "exchanges"]

FOLDER = Path(__file__).with_name("recorded")
_POSE, _MOVE = "/tenant/alpha/sensor/r7/pose", "/tenant/alpha/action/r7/move_to"
_ESTOP = "/system/estop"
_SILENCE = 3.0
Message = dict[str, Any]


def exchanges(version: str) -> list[Message]:
    """Return the requests of a hub of a version, each with what a gateway of it answered."""
    return json.loads((FOLDER / f"{version}.json").read_text())


async def _record() -> list[Message]:
    """Let a hub do what hubs do, and return every exchange over its link."""
    found: dict[str, Message] = {}
    send = Pipe.send

    def tapped(self: Pipe, data: bytes, priority: Priority) -> None:
        message = msgspec.msgpack.decode(data)
        id_ = message.pop("id", None)
        if isinstance(getattr(self, "_owner"), FleetLink):  # noqa: B009 - of the pipe's own
            found[id_] = {"request": message, "answers": []}
        elif id_ in found:
            found[id_]["answers"].append(message)
        send(self, data, priority)

    Pipe.send = tapped
    port, root = free_port(), key("root", ADMIN, role="admin")
    # The hub acts as an administrator there: it is to reset the e-stop.
    robot = robot_at(port).replace(
        'name = "operator"\nrole = "operator"', 'name = "hub"\nrole = "admin"'
    )
    async with serving(hub_at(port) + root) as hub, serving(robot):
        client = hub.client(ADMIN)
        await appears(client, _POSE)
        for type_, path, body in (
            ("read", _POSE, {"fresh": True}),
            ("write", "/tenant/alpha/param/r7/speed_limit", 0.5),
            ("execute", _MOVE, {"position": {"x": 0.1, "y": 0.0}}),
            ("execute", _ESTOP, {}),
            ("execute", _ESTOP, {"reset": True}),
        ):
            reply = await client.request(type_, path, body=body, within=60.0)
            assert reply["status"] == "completed", reply
        id_ = await client.subscribe(_POSE)
        for _ in range(3):  # the first may be what the hub has read before
            await client.update(id_)
        await client.close()
    kept = [one for one in found.values() if one["request"]["type"] != "hello" and one["answers"]]
    for one in kept:
        updates = [answer for answer in one["answers"] if answer["type"] == "update"]
        rest = [answer for answer in one["answers"] if answer["type"] != "update"]
        one["answers"] = rest + updates[:1]
    hello = next(one for one in found.values() if one["request"]["type"] == "hello")
    return [hello, *kept]


class RecordedGateway:
    """A robot's gateway that knows only what was recorded, as one of that version does."""

    def __init__(self, session: zenoh.Session, recorded: list[Message]) -> None:
        self._session, self._recorded = session, recorded
        self._pipes: dict[tuple[str, str], Pipe] = {}
        self.asked: list[tuple[str, str | None]] = []

    @classmethod
    async def joined(cls, stack: AsyncExitStack, port: int, recorded: list[Message]) -> Self:
        """Join a fleet as its robot r7."""
        ends = [f"tcp/127.0.0.1:{port}"]
        config = configuration("client", connect=ends, silence=_SILENCE)
        session = await stack.enter_async_context(opened(config, patient=True))
        made, loop, keys = (
            cls(session, recorded),
            asyncio.get_running_loop(),
            links_of("alpha", "r7"),
        )
        declared = [
            session.liveliness().declare_subscriber(
                keys.token, on_loop(loop, made._token), history=True
            ),
            session.declare_subscriber(keys.up, on_loop(loop, made._take)),
            session.liveliness().declare_token(alive("alpha", "r7")),
        ]
        stack.callback(made._close, declared)
        return made

    def _close(self, declared: list[Any]) -> None:
        for pipe in list(self._pipes.values()):
            pipe.end("the test is over")
        for one in reversed(declared):
            one.undeclare()

    def _token(self, sample: zenoh.Sample) -> None:
        link = part(sample.key_expr, 4), part(sample.key_expr, 5)
        if sample.kind == zenoh.SampleKind.PUT and link not in self._pipes:
            owner = _Owner(partial(self._pipes.pop, link, None))
            key = LinkKeys.of("alpha", "r7", *link).down
            self._pipes[link] = Pipe(self._session, key, _SILENCE, owner, Allowance())

    def _take(self, sample: zenoh.Sample) -> None:
        pipe = self._pipes.get((part(sample.key_expr, 4), part(sample.key_expr, 5)))
        message = None if pipe is None else pipe.receive(sample)
        if pipe is not None and message is not None and message.data is not None:
            request = msgspec.msgpack.decode(message.data)
            self.asked.append((request["type"], request.get("path")))
            for answer in self._answers(request):
                data = msgspec.msgpack.encode(answer | {"id": request.get("id")})
                updates = answer["type"] == "update"
                pipe.send(data, Priority.UPDATES if updates else Priority.CONTROL)

    def _answers(self, request: Message) -> list[Message]:
        same = [one for one in self._recorded if _kind(one["request"]) == _kind(request)]
        if same:
            return same[-1]["answers"]
        error = {
            "code": "unknown_path",
            "message": f"no resource {request.get('path')}",
            "origin": "gateway",
        }
        return [{"type": request["type"], "status": "rejected", "error": error}]


class _Owner:
    """Who uses a pipe of the recorded gateway."""

    longest = 1 << 24

    def __init__(self, gone: Any) -> None:
        self._gone = gone

    def drained(self) -> None:
        """Nothing waits."""

    def ended(self, why: str) -> None:
        """Forget the link."""
        self._gone()


def _kind(request: Message) -> tuple[Any, ...]:
    """Return by what a request is recognised in the recording."""
    body = request.get("body")
    facts = body if isinstance(body, dict) else {}
    reset = request.get("path") == _ESTOP and facts.get("reset", False)
    return request["type"], request.get("path"), facts.get("schemas"), reset


if __name__ == "__main__":
    recorded = asyncio.run(_record())
    FOLDER.mkdir(exist_ok=True)
    file = FOLDER / f"{gateway_version()}.json"
    file.write_text("[\n" + ",\n".join(map(json.dumps, recorded)) + "\n]\n")
