"""Two hubs of one fleet: each serves all robots, and whoever loses one goes on with the other."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509

pytest.importorskip("zenoh")

from backends.fleet.cart import Cart
from backends.fleet.rig import appears, catalogue, free_port, process_of, serving
from certs import Authority, Signed
from configuration import backend, configuration, key, listener, table
from hubkeys import HubKey
from plugins.client.heard import Heard
from rcp_client import Client as Person
from rcp_client import ConnectionLost, connect
from rcp_kernel.testing import ADMIN, OPERATOR, Client, Served, scripted

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


async def _opened(
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
        person = await _opened(stack, pair.urls, 2, heard)
        # The other one starts later: it knows nothing of what was before, but the robot does.
        await stack.enter_async_context(
            process_of(tmp_path / "h2.toml", pair.hub("h2", listens=True))
        )
        await _opened(stack, pair.urls.split(",")[1], 2)
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
