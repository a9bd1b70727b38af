"""A proof that ends, ends what it opened: over WebSocket, event streams and HTTP, on real sockets.

A token is taken back by `rcpd token revoke`, the `exp` of a JWT passes, a client certificate comes
to its `notAfter`, by the gateway's clock, which is put forward: each ends the streams, subscriptions, waiting answers and leases of its owner on
every transport, and the robot that was driven is brought to rest.
"""

from __future__ import annotations

import asyncio
import json
import ssl
import sys
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from certs import Authority, Signed
from configuration import backend, key, listener, table, tls
from issuer import AUDIENCE, Key
from issuer import Issuer as Signer
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, Served, SteppedClock, eventually, scripted, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import Twist, quantity
from rcp_store.tokens import TokenFile

pytestmark = pytest.mark.anyio
BOUND = 60.0  # s
LIFE = 600  # s that what expires is good for
CONTEXT = "/rcp/v1/context"
FAST = {"linear": {"x": 0.5}}
ENDED = "subscription_ended"
KINDS = ["token", "jwt", "certificate"]
TABLES = """
anonymous = false
[[certificates]]
name = "ann"
subject = "ann"
role = "operator"
[[jwt]]
issuer = "http://127.0.0.1:1"
audience = "{audience}"
keys = "{folder}/issuer.pem"
role = "operator"
leeway = 0
"""


RESOURCES = (
    Resource(name="sensor/level", description="A level.", value=quantity("m"), live=True),
    Resource(
        name="actuator/drive", description="A drive.", value=Twist, valid_for=0.3, safe=Twist()
    ),
    Resource(name="action/go", description="Goes.", input=quantity("m"), output=quantity("m")),
)


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the gateway see soon that its clock was set."""
    monkeypatch.setattr("rcp_kernel.sessions.credential_expiry._LOOK", 0.05)


class Place:
    """A gateway with two robots, and somebody whose proof is about to end."""

    def __init__(self, kind: str, folder: Path) -> None:
        self.kind = kind
        self.folder = folder
        self.time = SteppedClock()
        self.ca = Authority(folder)
        self.signer = Signer(1)
        self.signer.keys["k1"] = Key("k1", "ES256")
        (folder / "issuer.pem").write_text(self.signer.keys["k1"].pem)
        self.config = folder / "rcp.toml"
        server = self.ca.server()
        self.config.write_text(
            TABLES.format(folder=folder, audience=AUDIENCE)
            + listener()
            + tls(server, client_ca=self.ca.file, client_certificates="optional")
            + table("store", path=folder / "store.db")
            + backend()
            + backend("second", "beta")
            + key("admin", "admin-of-these-tests")
        )
        self.robots: list[ScriptedRobot] = []
        self.url = ""
        self.token: str | None = None
        self.certificate: Signed | None = None

    @asynccontextmanager
    async def serving(self) -> AsyncGenerator[Served]:
        """Run the gateway, then make the proof: its time begins."""

        def make(host: Host) -> ScriptedRobot:
            robot = ScriptedRobot(host, *RESOURCES)
            robot.measure("sensor/level", 1.0)
            self.robots.append(robot)
            return robot

        configure("error", "json")
        if self.kind == "token":
            with closing(TokenFile(self.folder / "store.db")) as table:
                _, self.token = table.create("ann", (("*", ("operator",)),), None)
        async with serve(
            parse(self.config.read_text(), "test"), scripted(make), clock=self.time.clock
        ) as served:
            self.url = next(f["url"] for f in served.server.status.transports if "url" in f)
            if self.kind == "jwt":
                self.token = self.signer.token(exp=int(time.time()) + LIFE, sub="ann")
            if self.kind == "certificate":
                self.certificate = self.ca.sign("ann", days=(-1, LIFE / 86_400))
            yield served

    async def end(self) -> None:
        """Take the token back, or let the time of what expires pass."""
        if self.kind == "token":
            program = Path(sys.executable).parent / "rcpd"
            words = ("token", "revoke", "ann", "--config", str(self.config))
            done = await asyncio.create_subprocess_exec(
                program,
                *words,
                env={"PYTHONPATH": ":".join(sys.path)},
                stdout=asyncio.subprocess.DEVNULL,
            )
            assert await done.wait() == 0
        else:
            self.time.adjust(LIFE + 1)

    @property
    def afterwards(self) -> str:
        """The code of whoever comes again with the same proof."""
        return "unauthenticated" if self.kind == "token" else "token_expired"

    def context(self, certificate: Signed | None = None) -> ssl.SSLContext:
        """Trust the gateway, and show a certificate."""
        made = ssl.create_default_context(cafile=self.ca.file)
        if certificate is not None:
            made.load_cert_chain(*certificate.pair)
        return made

    @asynccontextmanager
    async def http(self, token: str | None = None) -> AsyncGenerator[httpx.AsyncClient]:
        """Call the gateway, as whose proof ends if no other token is given."""
        shown = token or self.token
        headers = {} if shown is None else {"authorization": f"Bearer {shown}"}
        context = self.context(None if token else self.certificate)
        async with httpx.AsyncClient(
            base_url=self.url, verify=context, headers=headers, timeout=BOUND
        ) as client:
            yield client

    @asynccontextmanager
    async def socket(self) -> AsyncGenerator[Wire]:
        """Open a WebSocket."""
        url = self.url.replace("https", "wss") + "/rcp/v1/ws"
        async with connect(url, ssl=self.context(self.certificate)) as made:
            wire = Wire(made)
            body = {} if self.token is None else {"token": self.token}
            assert (await wire.ask(type="hello", body=body))["status"] == "completed"
            yield wire


class Wire:
    """A WebSocket's two ends of a conversation."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.said: list[dict[str, Any]] = []

    async def ask(self, **envelope: Any) -> dict[str, Any]:
        """Send a request; return its answer."""
        envelope.setdefault("id", envelope["type"])
        await self._socket.send(json.dumps(envelope))
        return await self.until(lambda m: m.get("id") == envelope["id"] and m["type"] != "update")

    async def until(self, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Read up to a message that fits."""
        async with asyncio.timeout(BOUND):
            while True:
                told = json.loads(await self._socket.recv())
                self.said.append(told)
                if fits(told):
                    return told

    async def end(self) -> int | None:
        """Read until the gateway closes; return its code."""
        with pytest.raises(ConnectionClosed):
            await self.until(lambda _: False)
        return self._socket.close_code


@asynccontextmanager
async def place(kind: str, folder: Path) -> AsyncGenerator[Place]:
    made = Place(kind, folder)
    async with made.serving():
        yield made


def code_of(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["error"]["code"]


async def within(*awaited: Awaitable[Any]) -> list[Any]:
    async with asyncio.timeout(BOUND):
        return await asyncio.gather(*awaited)


async def rested(robot: ScriptedRobot) -> None:
    """Wait until it was driven, and is at rest."""
    assert any(value != Twist() for _, value in robot.writes)

    async def still() -> bool:
        return not robot.moving

    await eventually(still, "the robot rests", BOUND)


def lease_of(tenant: str) -> dict[str, Any]:
    return {"do": "acquire", "scope": f"/tenant/{tenant}", "ttl": 300}


def drive_of(tenant: str) -> str:
    return f"/tenant/{tenant}/actuator/drive"


async def leases(here: Place) -> Any:
    """List the leases there are."""
    async with here.http("admin-of-these-tests") as admin:
        return (await admin.get(CONTEXT + "/system/leases")).json()["body"]


@pytest.mark.parametrize("kind", KINDS)
async def test_the_end_of_a_proof_ends_a_websocket_and_what_it_drives(
    kind: str, tmp_path: Path
) -> None:
    async with place(kind, tmp_path) as here, here.socket() as wire:
        robot = here.robots[0]
        await wire.ask(type="subscribe", id="s", path="/tenant/alpha/sensor/level")
        lease = await wire.ask(type="execute", path="/system/leases", body=lease_of("alpha"))
        assert lease["status"] == "completed", lease
        wrote = await wire.ask(type="write", path=drive_of("alpha"), body=FAST, valid_for=60)
        assert wrote["status"] == "completed", wrote
        await wire.ask(type="execute", id="go", path="/tenant/alpha/action/go", body=1.0)
        await within(robot.started.get())
        await here.end()
        assert await wire.end() == 1008
        last = wire.said[-1]
        assert (last["status"], last["error"]["code"]) == ("rejected", "token_expired")
        [ended] = [m for m in wire.said if m.get("code") == ENDED]
        assert (ended["id"], ended["reason"]) == ("s", "token_expired")
        await within(robot.stopped.get(), rested(robot))
        assert await leases(here) == []


@pytest.mark.parametrize("kind", KINDS)
async def test_the_end_of_a_proof_ends_an_event_stream(kind: str, tmp_path: Path) -> None:
    async with place(kind, tmp_path) as here, here.http() as http:
        url = "/rcp/v1/events?id=s&path=/tenant/alpha/sensor/level"
        async with http.stream("GET", url) as answer, asyncio.timeout(BOUND):
            lines = answer.aiter_lines()
            while not (await anext(lines)).startswith("event: update"):
                pass
            await here.end()
            rest = [json.loads(line[6:]) async for line in lines if line.startswith("data: ")]
        [ended] = [m for m in rest if m.get("code") == ENDED]
        assert (ended["id"], ended["reason"]) == ("s", "token_expired")
        assert rest[-1]["error"]["code"] == "token_expired"
        assert code_of(await http.get(url)) == (401, here.afterwards)


@pytest.mark.parametrize("kind", KINDS)
async def test_the_end_of_a_proof_ends_what_was_begun_over_http(kind: str, tmp_path: Path) -> None:
    async with place(kind, tmp_path) as here, here.http() as http:
        robot = here.robots[1]
        lease = await http.post(CONTEXT + "/system/leases", json=lease_of("beta"))
        assert lease.status_code == 200, lease.text
        wrote = await http.put(CONTEXT + drive_of("beta"), params={"valid_for": 60}, json=FAST)
        assert wrote.status_code == 200, wrote.text
        waiting = asyncio.create_task(
            http.post(CONTEXT + "/tenant/beta/action/go", json=1.0, headers={"Prefer": "wait=60"})
        )
        await within(robot.started.get())
        await here.end()
        [answer] = await within(waiting)
        assert code_of(answer) == (401, "token_expired")
        await within(robot.stopped.get(), rested(robot))
        assert code_of(await http.get(CONTEXT + drive_of("beta"))) == (401, here.afterwards)
        assert await leases(here) == []


@pytest.mark.parametrize("kind", KINDS)
async def test_who_drives_by_the_dead_man_drives_no_longer_than_the_proof(
    kind: str, tmp_path: Path
) -> None:
    async with place(kind, tmp_path) as here, here.http() as http:
        ending: asyncio.Task[None] | None = None
        async with asyncio.timeout(BOUND):
            while True:
                answer = await http.put(CONTEXT + drive_of("alpha"), json=FAST)
                if answer.status_code != 200:
                    break
                ending = ending or asyncio.create_task(here.end())
        # One that was on its way when the proof ended is told so, later ones what the proof is now.
        assert code_of(answer) in [(401, here.afterwards), (401, "token_expired")]
        assert ending is not None
        await within(ending, rested(here.robots[0]))
