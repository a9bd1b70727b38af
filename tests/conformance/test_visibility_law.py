"""Whatever the rules and the tree: nobody is told of what is hidden, over every wire."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import msgspec
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from configuration import backend, listener
from conformance.wires import BASE, HttpClient, SseClient, WebSocketClient, address, bearer
from rcp_gateway.testing import Client, MemoryClient, ScriptedRobot, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.config.file import GatewayConfig, KeyConfig, parse
from rcp_kernel.config.role import Role, Rule
from rcp_kernel.model import BRANCHES, Kind, Operation, Pattern, Resource, operation_names
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding

pytestmark = pytest.mark.anyio
TOKEN = "somebody-somebody"
CONFIG = (
    "anonymous = false\n"
    + listener()
    + backend("one", use="garden")
    + backend("two", "beta", use="garden")
)
OPS = ("discover", "read", "write", "execute", "subscribe")
TRUE, FALSE, UNKNOWN = "sensor.truth == 1", "sensor.truth == 2", "sensor.nowhere > 1"
STATE = {None: True, TRUE: True, FALSE: False, UNKNOWN: None}
SHAPES = ("sensor/q{}a", "sensor/arm/q{}b", "param/q{}c", "actuator/arm/q{}d", "action/q{}e",
          "service/arm/q{}f", "event/q{}g")  # fmt: skip
POOL = {tenant: [shape.format(tenant[0]) for shape in SHAPES] for tenant in ("alpha", "beta")}


class Garden(ScriptedRobot):
    """Takes everything, and has what an example wants."""

    def __init__(self, host: Host) -> None:
        super().__init__(
            host, Resource(name="sensor/truth", description="One.", value=int, live=True)
        )
        self.declared: set[str] = set()
        self.measure("sensor/truth", 1)

    def grow(self, names: set[str]) -> None:
        self.remove(*sorted(self.declared - names))
        for name in sorted(names - self.declared):
            number = quantity("1", description=f"about {name}")
            called = name.startswith(("action", "service"))
            kinds: Any = {"output": number} if called else {"value": number, "live": True}
            self.add(Resource(name=name, description=f"Of {name}.", **kinds))
            if called:
                self.behaviours[name] = half
            else:
                self.host.publish(name, 0.5)
        self.declared = names


async def half(value: Any, progress: Progress) -> Any:
    return 0.5


class Bench:
    """One gateway for every example, and one client."""

    def __init__(self, served: Served, gardens: list[Garden], client: Client, wire: str) -> None:
        self.gateway = served.server.gateway
        self.gardens = dict(zip(("alpha", "beta"), gardens, strict=True))
        self.client = client
        self.wire = wire
        self.http = httpx.AsyncClient(
            base_url=address(served.server), headers=bearer(TOKEN), trust_env=False, timeout=30
        )
        self.hidden = self.shown = 0


def configured(roles: dict[str, Role], held: dict[str, tuple[str, ...]]) -> GatewayConfig:
    key = KeyConfig(name="somebody", key=TOKEN, roles=dict(held))
    return msgspec.structs.replace(parse(CONFIG, "test"), roles=roles, keys=(key,))


@pytest.fixture
async def bench(request: pytest.FixtureRequest) -> AsyncGenerator[Bench]:
    """A gateway over one wire, for one test."""
    wire: str = request.param
    gardens: list[Garden] = []

    @asynccontextmanager
    async def opened(_config: Any, host: Host) -> AsyncIterator[Garden]:
        gardens.append(Garden(host))
        yield gardens[-1]

    start = configured({}, {"alpha": ("viewer",)})
    async with serve(start, BackendKind("garden", msgspec.Struct, opened)) as served:
        gardens.sort(key=lambda garden: garden.host.tenant)
        server = served.server
        if wire == "memory":
            client: Client = MemoryClient(server.client_api, TOKEN)
        elif wire == "websocket":
            client = await WebSocketClient.connected(server, TOKEN, Encoding.MSGPACK)
        else:
            made = SseClient if wire == "sse" else HttpClient
            client = made(server, TOKEN, Encoding.JSON)
        bench = Bench(served, gardens, client, wire)
        yield bench
        await client.close()
        await bench.http.aclose()
        assert bench.hidden > 50, "hardly anything was hidden"
        assert bench.shown > 50, "hardly anything was to be seen"


texts = st.sampled_from(
    ["/**", "/sensor/**", "/*/arm/*", "/param/*", "/tenant/*/sensor/*", "/tenant/beta/**",
     "/action/*", "/service/**", "/system/status", "/system/robots"]
)  # fmt: skip
operations = st.lists(st.sampled_from([*OPS, "*"]), min_size=1, max_size=3).map(tuple)
paths = st.lists(texts, min_size=1, max_size=2).map(tuple)
whens = st.sampled_from([None, None, TRUE, FALSE, UNKNOWN])
allows = st.builds(Rule, operations=operations, paths=paths, when=whens)
denies = st.one_of(
    st.builds(Rule, operations=operations, paths=paths),
    st.builds(
        Rule,
        operations=st.lists(st.sampled_from([*OPS[1:], "*"]), min_size=1, max_size=2).map(tuple),
        paths=paths,
        when=whens,
    ),
)
roles = st.builds(
    Role,
    allow=st.lists(allows, min_size=1, max_size=3).map(tuple),
    deny=st.lists(denies, max_size=2).map(tuple),
)
trees = st.fixed_dictionaries(
    {tenant: st.sets(st.sampled_from(names)) for tenant, names in POOL.items()}
)
held = st.dictionaries(
    st.sampled_from(["alpha", "beta", "*"]),
    st.lists(st.sampled_from(["r0", "r1"]), min_size=1, max_size=2, unique=True).map(tuple),
    min_size=1,
    max_size=2,
)


def hold(names: set[str]) -> set[str]:
    """Return the verb that the gateway offers for a robot with something that moves."""
    moves = any(name.startswith(("actuator/", "action/")) for name in names)
    return {"service/hold"} if moves else set()


class Model:
    """The contract, in the plainest words."""

    def __init__(
        self,
        tree: dict[str, set[str]],
        named: dict[str, Role],
        held: dict[str, tuple[str, ...]],
    ) -> None:
        self.held = [(place, named[name]) for place, names in held.items() for name in names]
        self.paths = sorted(
            f"/tenant/{tenant}/{name}"
            for tenant, names in tree.items()
            for name in {*names, "sensor/truth", *hold(names)}
        )
        self.tenants = [t for t in ("alpha", "beta") if t in held or "*" in held]

    def rules(self, path: str, kind: str) -> list[tuple[str, Rule]]:
        tenant = path.split("/")[2]
        found: list[tuple[str, Rule]] = []
        for place, role in self.held:
            if place not in ("*", tenant):
                continue
            for rule in getattr(role, kind):
                full = [t if t.startswith("/tenant/") else f"/tenant/*{t}" for t in rule.paths]
                if any(Pattern(t).matches(path) for t in full if not t.startswith("/tenant/*/sys")):
                    found += [
                        (op, rule)
                        for named in rule.operations
                        for op in (OPS if named == "*" else (named,))
                        if not (kind == "deny" and rule.when is not None and op == "discover")
                    ]
        return found

    def possible(self, path: str) -> set[str]:
        denied = {op for op, rule in self.rules(path, "deny") if rule.when is None}
        if "discover" in denied:
            return set()
        found = {op for op, _ in self.rules(path, "allow")} - denied
        return found | {"discover"} if found else set()

    def now(self, path: str) -> set[str]:
        allowed = {op for op, rule in self.rules(path, "allow") if STATE[rule.when] is True}
        denied = {op for op, rule in self.rules(path, "deny") if STATE[rule.when] is not False}
        return self.possible(path) & (allowed - denied)

    @staticmethod
    def offers(path: str) -> set[str]:
        return set(operation_names(BRANCHES[Kind(path.split("/")[3])]))

    def visible(self) -> list[str]:
        return [path for path in self.paths if self.possible(path)]

    def secrets(self) -> set[str]:
        """List the names that the rules hide; what is gone and never was hidden is no secret."""
        every = [f"/tenant/{tenant}/{name}" for tenant, names in POOL.items() for name in names]
        return {path.rpartition("/")[2] for path in every if not self.possible(path)}


def matching(model: Model, pattern: str) -> list[str]:
    own = model.tenants[0]
    full = pattern if pattern.startswith(("/tenant/", "/**")) else f"/tenant/{own}{pattern}"
    return [path for path in model.visible() if Pattern(full).matches(path)]


PATTERNS = ("/**", "/tenant/*/sensor/**", "/sensor/**", "/*/arm/*", "/tenant/beta/**")


LAW = settings(
    max_examples=60,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@LAW
@given(
    tree=trees,
    named=st.fixed_dictionaries({"r0": roles, "r1": roles}),
    held=held,
    pattern=st.sampled_from(PATTERNS),
    limit=st.sampled_from([1, 2, 100]),
    word=st.sampled_from([None, "arm", "qa", "qbb"]),
)
@pytest.mark.parametrize("bench", ["memory", "http", "websocket", "sse"], indirect=True)
async def test_nobody_is_told_of_what_is_hidden(
    bench: Bench,
    tree: dict[str, set[str]],
    named: dict[str, Role],
    held: dict[str, tuple[str, ...]],
    pattern: str,
    limit: int,
    word: str | None,
) -> None:
    for tenant, garden in bench.gardens.items():
        garden.grow(tree[tenant])
    model = Model(tree, named, held)
    bench.gateway.reconfigure(configured(named, held))
    for session in bench.gateway.sessions.known.values():
        session.tenant = model.tenants[0]  # as a client of these grants would have it
    bench.client.inbox.clear()
    bench.shown += len(model.visible())
    bench.hidden += len(model.paths) - len(model.visible())
    received = [
        await discovered(bench, model, pattern, limit, word),
        await read(bench, model, pattern),
        await subscribed(bench, model, pattern),
        await documents(bench),
    ]
    await asked(bench, model)
    text = json.dumps([received, bench.client.inbox])
    leaked = [text[at - 200 : at + 50] for name in model.secrets() if (at := text.find(name)) >= 0]
    assert not leaked


async def discovered(
    bench: Bench, model: Model, pattern: str, limit: int, word: str | None
) -> list[Any]:
    wanted = [p for p in matching(model, pattern) if not word or word in f"{p}"]
    body: dict[str, Any] = {"limit": limit} | ({"q": word} if word else {})
    found: list[Any] = []
    while True:
        reply = await bench.client.request("discover", pattern, body=body)
        found += reply["body"]["resources"]
        cursor = reply["body"].get("cursor")
        if cursor is None:
            break
        body["cursor"] = cursor
    seen = {r["path"]: set(r["operations"]) for r in found if r["path"].startswith("/tenant/")}
    assert list(seen) == wanted
    for path, offered in seen.items():
        assert offered == model.possible(path) & model.offers(path)
    return found


async def read(bench: Bench, model: Model, pattern: str) -> Any:
    reply = await bench.client.request("read", pattern)
    found = [i["path"] for i in reply["body"] if i["path"].startswith("/tenant/")]
    wanted = matching(model, pattern)
    assert found == [p for p in wanted if "read" in model.now(p) & model.offers(p)]
    return reply["body"]


async def subscribed(bench: Bench, model: Model, pattern: str) -> list[Any]:
    if bench.wire == "http":
        return []
    client = bench.client
    reply = await client.request("subscribe", pattern)
    assert reply["status"] == "completed", reply
    id_ = reply["body"]["subscription"]
    standing = [
        p for p in matching(model, pattern) if "subscribe" in model.possible(p) & model.offers(p)
    ]
    if bench.wire != "sse":
        assert [p for p in reply["body"]["paths"] if not p.startswith("/system/")] == standing
    received: list[Any] = []
    for path in standing:
        if "subscribe" in model.now(path):
            received.append(await client.until(lambda m, p=path: _of(m, id_, "update", p)))
        else:
            received.append(await client.until(lambda m, p=path: _of(m, id_, "notice", p)))
            assert received[-1]["code"] == "paused"
    for tenant, garden in bench.gardens.items():
        for name in sorted(garden.declared):
            if not name.startswith(("action", "service")):
                garden.host.publish(name, 0.25)
                path = f"/tenant/{tenant}/{name}"
                if path in standing and "subscribe" in model.now(path):
                    received.append(await client.until(lambda m, p=path: _of(m, id_, "update", p)))
    await client.request("unsubscribe", body={"subscription": id_})
    rest = [m for m in client.inbox if m["type"] == "update" and "/tenant/" in m["path"]]
    assert not rest
    return received


@LAW
@given(
    steps=st.lists(
        st.tuples(trees, st.fixed_dictionaries({"r0": roles, "r1": roles}), held),
        min_size=2,
        max_size=4,
    ),
    pattern=st.sampled_from(["/**", "/tenant/*/sensor/**", "/tenant/beta/**"]),
)
@pytest.mark.parametrize("bench", ["memory", "websocket", "sse"], indirect=True)
async def test_an_open_subscription_follows_rules_and_tree_and_tells_of_nothing_else(
    bench: Bench, steps: list[Any], pattern: str
) -> None:
    client = bench.client
    id_ = None
    before: set[str] = set()
    for number, (tree, named, held) in enumerate(steps):
        model = Model(tree, named, held)
        client.inbox.clear()
        bench.gateway.reconfigure(configured(named, held))
        for tenant, garden in bench.gardens.items():
            garden.grow(tree[tenant])
        if id_ is None:
            id_ = (await client.request("subscribe", pattern))["body"]["subscription"]
        standing = heard_of(model, pattern)
        if number:  # the rules came first, and met the tree of the step before
            before |= heard_of(Model(steps[number - 1][0], named, held), pattern)
        bench.shown += len(standing)
        bench.hidden += len(model.paths) - len(model.visible())
        heard = await published(bench, model, id_, standing, number + 2.0)
        mine = [m for m in (*heard, *client.inbox) if m.get("id") == id_]
        said = [m for m in mine if "/tenant/" in str(m.get("path"))]
        assert not [m for m in said if m["path"] not in standing | before]
        # What was on its way may come late, but nothing of now that is not allowed now.
        fresh = [m for m in said if m["type"] == "update" and m["body"] == number + 2.0]
        assert all("subscribe" in model.now(m["path"]) for m in fresh)
        text = json.dumps(said)
        known = {path.rpartition("/")[2] for path in before}
        assert not [name for name in model.secrets() - known if name in text]
        before |= standing
    await client.request("unsubscribe", body={"subscription": id_})


def heard_of(model: Model, pattern: str) -> set[str]:
    """List what a subscription of a pattern is told of, whatever the conditions."""
    found = matching(model, pattern)
    return {p for p in found if "subscribe" in model.possible(p) & model.offers(p)}


async def published(
    bench: Bench, model: Model, id_: str, standing: set[str], value: float
) -> list[Any]:
    """Publish on every path, and wait for what is to be heard."""
    for garden in bench.gardens.values():
        garden.host.publish("sensor/truth", 1)
        for name in sorted(garden.declared):
            if not name.startswith(("action", "service")):
                garden.host.publish(name, value)
    return [
        await bench.client.until(
            lambda m, p=path: (
                _of(m, id_, "update", p) and m["body"] == (1 if p.endswith("truth") else value)
            )
        )
        for path in sorted(standing)
        if "subscribe" in model.now(path)
    ]


def _of(message: Any, id_: str, type_: str, path: str) -> bool:
    return (message["type"], message.get("id"), message.get("path")) == (type_, id_, path)


async def documents(bench: Bench) -> list[str]:
    """Fetch what is there over HTTP beside envelopes."""
    places = ("/openapi.json", f"{BASE}/schemas", f"{BASE}/status", f"{BASE}/commands", "/readyz",
              f"{BASE}/discovery?path=/**&limit=3", f"{BASE}/openapi.json")  # fmt: skip
    return [(await bench.http.get(place)).text for place in places]


async def asked(bench: Bench, model: Model) -> None:
    """Ask for every operation on every path, and on such as are not there."""
    named = [f"/tenant/{t}/{name}" for t, names in POOL.items() for name in names]
    parts = [
        {"type": type_, "path": place, **({"body": 0.5} if type_ == "write" else {})}
        for path in named
        for type_ in ("read", "write", "execute", "cancel")
        for place in (path, ghost(path))
    ]
    replies: list[Any] = []
    for some in _by(parts, 64):
        reply = await bench.client.request("batch", body=list(some))
        assert reply["status"] == "completed", reply
        replies += reply["body"]
    for number in range(0, len(parts), 2):
        part, reply, none = parts[number], replies[number], replies[number + 1]
        path = str(part["path"])
        assert none["error"]["code"] == "unknown_path"
        if path not in model.visible():
            assert plainly(reply, path) == plainly(none, ghost(path))
        else:
            check(model, path, str(part["type"]), reply)
    # One by one too: a batch is a way in of its own.
    for path in named[:: len(SHAPES) // 2]:
        reply = await bench.client.request("read", path)
        if path not in model.visible():
            none = await bench.client.request("read", ghost(path))
            assert plainly(reply, path) == plainly(none, ghost(path))
        else:
            check(model, path, "read", reply)


def check(model: Model, path: str, type_: str, reply: Any) -> None:
    operation = "execute" if type_ == "cancel" else type_
    code = None if reply.get("error") is None else reply["error"]["code"]
    if operation not in model.offers(path):
        assert code == "unsupported_operation"
    elif operation not in model.now(path):
        assert code == "forbidden"
        truth = "/".join([*path.split("/")[:3], "sensor", "truth"])
        assert "read" in model.now(truth) or "sensor." not in json.dumps(reply)
    else:  # the parts of a batch run side by side, and a `cancel` finds its `execute`
        assert code in (None, "cancelled"), reply


def ghost(path: str) -> str:
    """Make a path of the same length that is never there."""
    return path[:-3] + "x" + path[-2:]


def plainly(reply: Any, path: str) -> Any:
    """Leave out of a reply what is another in each."""
    text = json.dumps(reply).replace(path, "PATH")
    return re.sub(r'"(id|timestamp|trace_id)": "[^"]*"', "", text)


def _by(parts: list[Any], size: int) -> list[list[Any]]:
    return [parts[start : start + size] for start in range(0, len(parts), size)]


def test_the_model_knows_every_operation() -> None:
    assert {op.name.lower() for op in Operation if op.name} == set(OPS)
