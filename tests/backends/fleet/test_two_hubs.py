"""Two hubs of one fleet: each serves all robots, and whoever loses one goes on with the other."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509

pytest.importorskip("zenoh")

from backends.fleet.cart import Cart
from backends.fleet.rig import appears, catalogue, process_of, serving
from certs import Authority, Signed
from clients.test_typescript import typescript
from configuration import backend, configuration, key, listener, table
from hubkeys import HubKey
from plugins.client.heard import Heard
from plugins.client.test_codegen import node
from ports import free_port
from rcp_client import Client as Person
from rcp_client import ConnectionLost, connect
from rcp_gateway.testing import ADMIN, OPERATOR, Client, Served, eventually, scripted

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_KEYS = key("ann", OPERATOR, role="operator") + key("root", ADMIN, role="admin")
_ALL = "/tenant/alpha/action/*/go"
_COUNT, _GO = "/tenant/alpha/sensor/r7/count", "/tenant/alpha/action/r7/go"


class Pair:
    """Two hubs, each with a router that is linked with the other's, and what robots need of them."""

    def __init__(self, folder: Path, *, tls: bool = False) -> None:
        self._folder = folder
        self._authority = Authority(folder) if tls else None
        self.ports = {"h1": free_port(), "h2": free_port()}
        self.web = {"h1": free_port(), "h2": free_port()}
        self._keys = {hub: HubKey(hub) for hub in self.ports}
        for hub, made in self._keys.items():
            file = folder / f"{hub}.key"
            file.write_text(made.private_pem)
            file.chmod(0o600)

    @property
    def urls(self) -> str:
        """Where persons find the hubs, if these listen."""
        return ",".join(f"http://127.0.0.1:{port}" for port in self.web.values())

    def _ends(self, *hubs: str) -> list[str]:
        scheme = "tcp" if self._authority is None else "tls"
        return [f"{scheme}/127.0.0.1:{self.ports[hub]}" for hub in hubs]

    def _files(self, signed: Signed) -> dict[str, Any]:
        assert self._authority is not None
        signed.key.chmod(0o600)
        return {"ca": self._authority.file, "certificate": signed.cert, "key": signed.key}

    def hub(self, name: str, *, listens: bool = False, store: bool = False) -> str:
        """Return the configuration of one of the hubs."""
        (other,) = self.ports.keys() - {name}
        secured: dict[str, Any] = {}
        if self._authority is not None:
            loopback = x509.IPAddress(ip_address("127.0.0.1"))
            signed = self._authority.sign(name, sans=(loopback,), file=f"{name}-link")
            secured = {"robots": ["r1", "r2", "r7"], "routers": [other], "tls": self._files(signed)}
        fleet = backend(
            "fleet",
            use="fleet",
            hub=name,
            listen=self._ends(name),
            connect=self._ends(other),
            key=str(self._folder / f"{name}.key"),
            silence=1.0,
            **secured,
        )
        kept = table("store", path=str(self._folder / f"{name}.db")) if store else ""
        head = listener(self.web[name]) if listens else configuration()
        return head + fleet + _KEYS + kept

    def robot(self, name: str = "r7", *hubs: str) -> str:
        """Return the configuration of a robot that dials some of the hubs, or both."""
        ends = self._ends(*(hubs or self.ports))
        link: dict[str, Any] = {"gateway": name, "tenant": "alpha", "connect": ends}
        if self._authority is not None:
            link["tls"] = self._files(self._authority.sign(name))
        zenoh = table("transports.zenoh", silence=1.0, **link)
        tables = [
            made.table('["operator", "admin"]', 'people = "staff"') for made in self._keys.values()
        ]
        return configuration(zenoh, backend("cart"), _KEYS, *tables)


@asynccontextmanager
async def _robot(pair: Pair, name: str = "r7", *hubs: str) -> AsyncGenerator[tuple[Served, Cart]]:
    async with serving(pair.robot(name, *hubs), scripted(Cart)) as served:
        cart: Any = served.life.backend
        yield served, cart


async def _client(stack: AsyncExitStack, gateway: Served, secret: str = OPERATOR) -> Client:
    client = gateway.client(secret)
    stack.push_async_callback(client.close)
    return client


async def opened(
    stack: AsyncExitStack, url: str, robots: int, heard: Heard | None = None
) -> Person:
    """Connect to a hub's process once it listens, and wait until it has all robots."""
    person = connect(url, token=OPERATOR, patience=None, on_notice=heard)
    while not person.connected:
        with suppress(ConnectionLost):
            await person.channel.open()
        await asyncio.sleep(0.05)
    stack.push_async_callback(person.channel.close)
    while len(await person.discover(_ALL)) < robots:  # noqa: ASYNC110 - of another process
        await asyncio.sleep(0.05)
    return person


@pytest.mark.parametrize("tls", [False, True])
async def test_both_hubs_show_all_robots_whichever_of_them_these_dial(
    tmp_path: Path, *, tls: bool
) -> None:
    pair = Pair(tmp_path, tls=tls)
    async with AsyncExitStack() as stack:
        hubs = [await stack.enter_async_context(serving(pair.hub(hub))) for hub in pair.ports]
        carts = [
            (await stack.enter_async_context(_robot(pair, *robot)))[1]
            for robot in (("r1", "h1"), ("r2", "h2"), ("r7",))
        ]
        clients = [await _client(stack, hub) for hub in hubs]
        robots = ("r1", "r2", "r7")
        for client in clients:
            for robot in robots:
                await appears(client, f"/tenant/alpha/sensor/{robot}/count")
        ids = [await client.subscribe("/tenant/alpha/sensor/*/count") for client in clients]
        while any(len(cart.watched) < 1 for cart in carts):  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.01)
        found: list[dict[str, Any]] = [{}, {}]
        for number, cart in enumerate(carts):
            cart.measure("sensor/count", float(number))
        for client, id_, values in zip(clients, ids, found, strict=True):
            while len(values) < len(robots):
                update = await client.until(lambda m, id_=id_: m.get("id") == id_ and "seq" in m)
                facts = [update[name] for name in ("body", "seq", "timestamp")]
                values[update["path"]] = facts
        assert found[0] == found[1]
        assert sorted(body for body, *_ in found[0].values()) == [0.0, 1.0, 2.0]
        first, second = [await catalogue(client, "/tenant/alpha/action/**") for client in clients]
        assert first == second


async def test_a_person_whose_hub_is_killed_goes_on_with_the_other(tmp_path: Path) -> None:
    pair, heard = Pair(tmp_path), Heard()
    async with AsyncExitStack() as stack:
        _, cart = await stack.enter_async_context(_robot(pair))
        _, other = await stack.enter_async_context(_robot(pair, "r1"))
        first = await stack.enter_async_context(
            process_of(tmp_path / "h1.toml", pair.hub("h1", listens=True))
        )
        person = await opened(stack, pair.urls, 2, heard)
        # The other one starts later: it knows nothing of what was before, but the robot does.
        await stack.enter_async_context(
            process_of(tmp_path / "h2.toml", pair.hub("h2", listens=True))
        )
        await opened(stack, pair.urls.split(",")[1], 2)
        cart.measure("sensor/count", 1.0)
        seen = aiter(person.subscribe(_COUNT, reliable=True))
        assert (await anext(seen)).body == 1.0
        sent = [
            asyncio.create_task(person.execute(_GO, 1.0, idempotency_key="mine")),
            asyncio.create_task(person.execute(_GO.replace("r7", "r1"), 1.0)),
        ]
        for one in (cart, other):
            await asyncio.wait_for(one.started.get(), _BOUND)
        first.kill()
        await heard.until("reconnected")
        await heard.until("gap")
        cart.measure("sensor/count", 2.0)
        while (await asyncio.wait_for(anext(seen), _BOUND)).body != 2.0:
            pass
        for one in (cart, other):
            assert (one.halts, one.stopped.empty()) == (0, True)
            one.release.set()
        assert [await asyncio.wait_for(one, _BOUND) for one in sent] == [1.0, 1.0]
        assert await person.execute(_GO, 1.0, idempotency_key="mine") == 1.0
        assert [cart.ran, other.ran] == [[("action/go", 1.0)]] * 2


@pytest.mark.skipif(node() is None, reason="needs Node")
async def test_a_typescript_client_whose_hub_is_killed_goes_on_with_the_other(
    tmp_path: Path,
) -> None:
    pair, found = Pair(tmp_path), node()
    assert found is not None
    async with AsyncExitStack() as stack:
        _, cart = await stack.enter_async_context(_robot(pair))
        hubs = {
            hub: await stack.enter_async_context(
                process_of(tmp_path / f"{hub}.toml", pair.hub(hub, listens=True))
            )
            for hub in pair.ports
        }
        for url in pair.urls.split(","):
            await opened(stack, url, 1)
        cart.measure("sensor/count", 1.0)
        client = await asyncio.create_subprocess_exec(
            found, "--no-warnings", "test/failover.ts",
            stdout=asyncio.subprocess.PIPE,
            cwd=typescript(tmp_path),
            env=os.environ
            | {"RCP_URL": pair.urls, "RCP_TOKEN": OPERATOR, "RCP_GO": _GO, "RCP_COUNT": _COUNT},
        )  # fmt: skip
        stack.callback(lambda: client.returncode is None and client.kill())

        async def says(line: str) -> None:
            assert client.stdout is not None
            async with asyncio.timeout(_BOUND):
                while (told := (await client.stdout.readline()).decode().strip()) != line:
                    assert told, f"the client ended before it said {line!r}"

        await says("accepted")
        hubs["h1"].kill()
        await says("other hub")
        cart.measure("sensor/count", 2.0)
        await says("count 2")
        assert (cart.halts, cart.stopped.empty()) == (0, True)
        cart.release.set()
        await says("result 1")
        assert cart.ran == [("action/go", 1.0)]
        assert await asyncio.wait_for(client.wait(), _BOUND) == 0


async def _estop(client: Client, **body: Any) -> dict[str, Any]:
    return await client.request(
        "execute", "/system/estop", body=body, within=_BOUND, deadline=body.pop("deadline", _BOUND)
    )


async def _held(client: Client) -> dict[str, str]:
    """Return the latched robots with the state of each one's stop."""
    told = (await client.request("read", "/system/estop"))["body"]["robots"]
    return {name: one["state"] for name, one in told.items()}


async def _holds(client: Client, robots: dict[str, str]) -> None:
    async def holds() -> bool:
        return await _held(client) == robots

    await eventually(holds, f"{robots or 'nothing'} is latched", _BOUND)


@asynccontextmanager
async def _stopping(
    pair: Pair, *, store: bool = False
) -> AsyncGenerator[tuple[list[Served], list[Client], Client, Cart]]:
    """Run two hubs and one robot, with an administrator at each."""
    async with AsyncExitStack() as stack:
        hubs = [
            await stack.enter_async_context(serving(pair.hub(hub, store=store)))
            for hub in pair.ports
        ]
        served, cart = await stack.enter_async_context(_robot(pair))
        roots = [await _client(stack, hub, ADMIN) for hub in hubs]
        for root in roots:
            await appears(root, _GO)
        yield hubs, roots, await _client(stack, served, ADMIN), cart


async def test_a_stop_by_one_hub_is_shown_and_can_be_reset_at_the_other(tmp_path: Path) -> None:
    async with _stopping(Pair(tmp_path)) as (hubs, (one, two), robot, cart):
        assert (await _estop(one, reason="smoke"))["status"] == "completed"
        await _holds(two, {"fleet/r7": "confirmed"})
        refused = await two.request("execute", _GO, body=1.0)
        assert refused["error"]["code"] == "estop_active", refused
        ann = hubs[1].client(OPERATOR)
        refused = await _estop(ann, reset=True)
        assert refused["error"]["code"] == "forbidden", refused
        await ann.close()
        halts = cart.halts
        assert (await _estop(two, reset=True))["status"] == "completed"
        for client in (one, two, robot):
            await _holds(client, {})
        cart.release.set()
        for client in (one, two):
            done = await client.request("execute", _GO, body=1.0, within=_BOUND)
            assert done["status"] == "completed", done
        assert cart.halts == halts  # nobody has stopped it again


async def test_a_stop_and_a_reset_at_the_robot_are_those_of_both_hubs(tmp_path: Path) -> None:
    async with _stopping(Pair(tmp_path)) as (_, (one, two), robot, _cart):
        assert (await _estop(robot))["status"] == "completed"
        for client in (one, two):
            await _holds(client, {"fleet/r7": "confirmed"})
        assert (await _estop(robot, reset=True))["status"] == "completed"
        for client in (one, two):
            await _holds(client, {})


async def test_a_reset_by_name_at_the_robot_lets_go_of_it_at_the_hubs_too(tmp_path: Path) -> None:
    async with _stopping(Pair(tmp_path)) as (_, (one, two), robot, _cart):
        assert (await _estop(one))["status"] == "completed"
        (name,) = await _held(robot)
        reset = await _estop(robot, reset=True, scope=name)
        assert reset["body"]["scopes"], "the tenant's latch goes on for others"
        for client in (one, two):
            await _holds(client, {})


async def test_stops_and_resets_at_both_hubs_at_once_leave_all_with_what_the_robot_has(
    tmp_path: Path,
) -> None:
    async with _stopping(Pair(tmp_path)) as (_, (one, two), robot, cart):
        for reply in await asyncio.gather(_estop(one), _estop(two)):
            assert reply["status"] == "completed", reply
        for client in (one, two, robot):
            name = "cart" if client is robot else "fleet/r7"
            await _holds(client, {name: "confirmed"})
        for reply in await asyncio.gather(_estop(one, reset=True), _estop(two, reset=True)):
            assert reply["status"] == "completed", reply
        for client in (one, two, robot):
            await _holds(client, {})
        for _ in range(3):  # whichever of the two the robot has last
            await asyncio.gather(_estop(one, deadline=1.0), _estop(two, reset=True))

            async def agree() -> bool:
                held = [await _held(client) for client in (one, two, robot)]
                return len({bool(found) for found in held}) == 1

            await eventually(agree, "both hubs show what the robot has", _BOUND)
        assert (await _estop(two))["status"] == "completed"
        for client in (one, two):
            await _holds(client, {"fleet/r7": "confirmed"})
        assert cart.moving == set()


@pytest.mark.parametrize("store", [False, True])
async def test_a_hub_that_is_started_again_does_not_release_what_is_stopped(
    tmp_path: Path, *, store: bool
) -> None:
    pair = Pair(tmp_path)
    async with AsyncExitStack() as stack:
        second = await stack.enter_async_context(serving(pair.hub("h2")))
        served, _ = await stack.enter_async_context(_robot(pair))
        two = await _client(stack, second, ADMIN)
        robot = await _client(stack, served, ADMIN)
        async with serving(pair.hub("h1", store=store)) as first:
            one = first.client(ADMIN)
            await appears(one, _GO)
            assert (await _estop(one))["status"] == "completed"
            await one.close()
        await appears(two, _GO)
        await _holds(two, {"fleet/r7": "confirmed"})
        first = await stack.enter_async_context(serving(pair.hub("h1", store=store)))
        one = await _client(stack, first, ADMIN)
        await appears(one, _GO)
        for client in (one, two):
            await _holds(client, {"fleet/r7": "confirmed"})
        assert await _held(robot) == {"cart": "confirmed"}
        assert (await _estop(two, reset=True))["status"] == "completed"
        for client in (one, two, robot):
            await _holds(client, {})


async def test_commands_that_wait_outlive_their_hub_in_one_queue(tmp_path: Path) -> None:
    pair, path = Pair(tmp_path), "/tenant/alpha/action/r7/line"
    async with AsyncExitStack() as stack:
        second = await stack.enter_async_context(serving(pair.hub("h2")))
        served, cart = await stack.enter_async_context(_robot(pair))
        two = await _client(stack, second)
        robot = await _client(stack, served, ADMIN)

        async def waiting(number: int) -> None:
            async def so_many() -> bool:
                found = (await robot.request("read", "/system/commands"))["body"]
                return [one["status"] for one in found].count("pending") == number

            await eventually(so_many, f"{number} wait at the robot", _BOUND)

        async with serving(pair.hub("h1", store=True)) as first:
            one = first.client(OPERATOR)
            for client in (one, two):
                await appears(client, path)
            await one.send(type="execute", path=path, body=1.0)
            await asyncio.wait_for(cart.started.get(), _BOUND)
            await one.send(type="execute", path=path, body=2.0)
            await waiting(1)
            last = await two.send(type="execute", path=path, body=3.0)
            await waiting(2)
            await one.close()
        first = await stack.enter_async_context(serving(pair.hub("h1", store=True)))
        one = await _client(stack, first)
        await appears(one, path)
        cart.release.set()
        assert (await two.final(last, _BOUND))["status"] == "completed"

        async def completed() -> bool:
            found = (await one.request("read", "/system/commands"))["body"]
            return sorted(str((c["status"], c.get("body"))) for c in found) == [
                "('completed', 1.0)",
                "('completed', 2.0)",
            ]

        await eventually(completed, "the hub has both final replies", _BOUND)
        assert cart.ran == [("action/line", value) for value in (1.0, 2.0, 3.0)]
