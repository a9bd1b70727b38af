"""Whatever is hidden and whatever happens there: it leaves no trace in what is told of the past.

Two gateways do the same, but the second one does nothing with what a reader may not see. What that
reader is told of the record, the commands, the plans and all else is the same, up to ids and times.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
import structlog
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from configuration import backend, configuration, key, role, rule, table
from kernel.world import BOUND, Client, Robot, World, settled, world_of
from rcp_kernel.model import Pattern, Resource
from rcp_kernel.spi import Host, Progress

pytestmark = pytest.mark.anyio
ACTOR, READER = "acts-in-all-tenants", "reader-reader-reader"
SECRET = "swordfish"
ROBOTS = {"robot": ("alpha", ""), "dark": ("alpha", "dark/"), "other": ("beta", "")}
NAMES = ("param/{}limit", "service/{}echo", "service/{}secret", "sensor/{}hush")
DENIES = (
    "/service/secret",
    "/sensor/hush",
    "/*/dark/**",
    "/param/**",
    "/service/dark/*",
    "/tenant/beta/sensor/**",
    "/tenant/beta/**",
    "/**/limit",
)
CONFIG = configuration(
    table("audit", denials=1000),
    backend("robot"),
    backend("dark", robot="dark"),
    backend("other", "beta"),
    key("actor", "acts-in-all-tenants", roles={"alpha": "admin", "beta": "admin"}),
)


class Dumb(Robot):
    """Takes everything at once."""

    def declare(self) -> None:
        number: Any = {"value": float, "live": True}
        words: Any = {"input": str, "output": str}
        self.add(
            Resource(name="param/limit", description="A limit.", value=float),
            Resource(name="service/echo", description="Answers.", **words),
            Resource(name="service/secret", description="Answers.", **words),
            Resource(name="sensor/hush", description="Quiet.", **number),
        )
        self.host.publish("sensor/hush", 271.828)

    async def write(self, name: str, value: Any) -> None:
        pass

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        return value


class Op(NamedTuple):
    """One thing that can be done to a resource."""

    robot: str
    name: str

    @property
    def path(self) -> str:
        tenant, robot = ROBOTS[self.robot]
        return f"/tenant/{tenant}/{self.name.format(robot)}"

    @property
    def do(self) -> str:
        return {"param": "write", "service": "execute", "sensor": "read"}[self.name.split("/")[0]]

    def value(self, *, secret: bool) -> Any:
        if self.do == "read":
            return None
        return 31.4159 if self.do == "write" else SECRET if secret else "plain"


class Act(NamedTuple):
    """Something that happens, with all it is about."""

    kind: str
    ops: tuple[Op, ...]


ops = st.builds(Op, st.sampled_from(sorted(ROBOTS)), st.sampled_from(NAMES))
acts = st.one_of(
    st.builds(Act, st.just("one"), st.tuples(ops)),
    st.builds(Act, st.just("plan"), st.lists(ops, min_size=1, max_size=4).map(tuple)),
    st.builds(Act, st.just("plan"), st.lists(ops, min_size=2, max_size=4).map(tuple)),
    st.builds(
        Act,
        st.sampled_from(["refused", "refused plan", "stop", "lease", "log", "named"]),
        st.tuples(ops),
    ),
)


class Law:
    """What the rules say, in the plainest words."""

    def __init__(self, denied: set[str], tenants: list[str]) -> None:
        self.denied = sorted(denied)
        self.tenants = tenants

    @property
    def config(self) -> str:
        deny = [rule("*", *self.denied)] if self.denied else []
        held = dict.fromkeys(self.tenants, "reader")
        return (
            CONFIG
            + role("reader", rule("*", "/**", "/system/**"), deny=deny, may_approve=True)
            + key("reader", "reader-reader-reader", roles=held)
        )

    def hides(self, path: str) -> bool:
        tenant = path.split("/")[2]
        full = [p if p.startswith("/tenant/") else f"/tenant/{tenant}{p}" for p in self.denied]
        return tenant not in self.tenants or any(Pattern(p).matches(path) for p in full)

    def hides_robot(self, robot: str) -> bool:
        """A robot shows as long as anything of it does: the verb that holds it is not of these."""
        return all(self.hides(Op(robot, name).path) for name in NAMES)


async def happen(world: World, actor: Client, act: Act, law: Law, *, all_of_it: bool) -> str | None:
    """Do it, or what the reader may see of it; return the command of a plan that hides something."""
    [op, *_] = act.ops
    seen = [one for one in act.ops if not law.hides(one.path)]
    secret = len(seen) < len(act.ops)
    if act.kind == "plan":
        steps = [
            {"do": o.do, "path": o.path, "id": f"s{n}"}
            | ({} if o.do == "read" else {"value": o.value(secret=law.hides(o.path))})
            for n, o in enumerate(act.ops)
            if all_of_it or o in seen
        ]
        if not steps:
            return None
        reply = await actor.ask(type="execute", path="/system/plans", body={"steps": steps})
        assert reply["status"] == "completed", reply
        return reply["command"] if secret else None
    if act.kind == "stop":
        if all_of_it or not law.hides_robot(op.robot):
            body = {"scope": op.robot, "reason": "a test"}
            for reset in (False, True):
                await actor.ask(type="execute", path="/system/estop", body={**body, "reset": reset})
        return None
    if secret and not all_of_it:
        return None
    envelope = {"type": op.do, "path": op.path}
    if op.do != "read":
        envelope["body"] = op.value(secret=secret)
    if act.kind == "one":
        await actor.ask(**envelope)
    elif act.kind == "refused":
        await actor.ask(**{**envelope, "type": "write", "body": {"no": SECRET if secret else 1}})
    elif act.kind == "refused plan":
        step = {"do": "write", "path": op.path, "value": {"no": SECRET if secret else 1}}
        await actor.ask(type="execute", path="/system/plans", body={"steps": [step]})
    elif act.kind == "lease":
        for do in ("acquire", "release"):
            await actor.ask(
                type="execute", path="/system/leases", body={"do": do, "scope": op.path}
            )
    elif act.kind == "log":
        structlog.get_logger("law").warning("noted", path=op.path)
        structlog.get_logger("law").warning("noted", backend=op.robot, detail=f"so: {op.path}.")
    else:  # something that may be seen names it
        told = {"body": f"about {op.path.split('/', 3)[3]}", "x-about": op.path}
        await actor.ask(type="execute", path=Op(op.robot, NAMES[1]).path, **told)
    return None


async def told(law: Law, done: list[Act], *, all_of_it: bool) -> tuple[dict[str, Any], set[str]]:
    """Return what the reader is told, and the plans that hid something from it."""
    async with world_of(law.config, make=_made) as world:
        reader, actor = world.client(READER), world.client(ACTOR)
        ask: Callable[..., Any] = reader.ask
        for name in ("audit", "log"):
            body = {"qos": {"depth": 1000}}
            await ask(type="subscribe", id=name, path=f"/system/{name}", body=body)
        dark = {await happen(world, actor, act, law, all_of_it=all_of_it) for act in done}
        await settled(world.server.gateway.store)
        await ask(type="write", path=f"/tenant/{law.tenants[0]}/param/mark", body=1)
        await settled(world.server.gateway.store)
        found: dict[str, Any] = {"audit": await _until_mark(reader, "audit")}
        structlog.get_logger("law").warning(
            "mark", path=f"/tenant/{law.tenants[0]}/sensor/{'x' * 9}"
        )
        for name in ("commands", "plans", "approvals", "leases", "estop"):
            found[name] = (await ask(type="read", path=f"/system/{name}"))["body"]
        body = {"history": 1000, "qos": {"depth": 1000}}
        await ask(type="subscribe", id="past", path="/system/audit", body=body)
        found["past"] = await _until_mark(reader, "past")
        found["last"] = (await ask(type="read", path="/system/audit"))["body"]
        status = (await ask(type="status"))["body"]
        found["status"] = {key: status[key] for key in ("commands", "warnings", "resources")}
        if any(act.kind == "named" and law.hides(act.ops[0].path) for act in done):
            # A command on what may be seen counts, also where it is not shown for what it names.
            del found["status"]["commands"]
        found["log"] = [m["body"] for m in reader.inbox if m.get("id") == "log" and "body" in m]
        return found, {command for command in dark if command is not None}


def _made(host: Host) -> Robot:
    return Dumb(host)


async def _until_mark(reader: Client, id_: str) -> list[Any]:
    out: list[Any] = []
    async with asyncio.timeout(BOUND):
        while not out or not str(out[-1].get("path")).endswith("/mark"):
            out.append((await reader.update(id_))["body"])
    return [record for record in out if record["what"] != "start"]


_TIMES = re.compile(
    r'"(?:seq|time|timestamp|id|command|session|created|updated|finished|since|started|ended|reset|lease|x-plan|x-traceparent)":'
    r' (?:"[^"]*"|\d+),? ?'
)


def plainly(value: Any) -> str:
    """Write what was told, without what is another each time."""
    return re.sub(r"[ac]md-[0-9a-f]{16}", "cmd", _TIMES.sub("", json.dumps(value, sort_keys=True)))


def without(found: dict[str, Any], plans: set[str]) -> dict[str, Any]:
    """Leave out the plans of the second gateway that stand for parts of one of the first."""
    out = dict(found)
    for name in ("audit", "past", "commands", "plans"):
        out[name] = [
            one
            for one in found[name]
            if one.get("command") not in plans
            or one.get("path", "/system/plans") != "/system/plans"
        ]
    return out


@given(
    denied=st.sets(st.sampled_from(DENIES), max_size=4),
    tenants=st.sampled_from([["alpha"], ["alpha", "beta"], ["beta"]]),
    done=st.lists(acts, min_size=1, max_size=7),
)
@settings(
    max_examples=60,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
def test_what_is_hidden_leaves_no_trace_in_what_is_told_of_the_past(
    denied: set[str], tenants: list[str], done: list[Act]
) -> None:
    law = Law(denied, tenants)

    async def both() -> tuple[Any, Any]:
        whole, dark = await told(law, done, all_of_it=True)
        parts, stand_ins = await told(law, done, all_of_it=False)
        assert not [one for one in whole["plans"] if one["command"] in dark]
        return whole, without(parts, stand_ins)

    whole, parts = asyncio.run(both())
    assert SECRET not in json.dumps(whole)
    for name in whole:
        assert plainly(whole[name]) == plainly(parts[name]), name
