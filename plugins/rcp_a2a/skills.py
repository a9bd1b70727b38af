"""The skills of the agent's card: plans, the emergency stop, and a tenant's actions and services."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

import msgspec
from a2a.types.a2a_pb2 import AgentSkill

from rcp_gateway.api import Query, Session
from rcp_gateway.client_api import ClientApi
from rcp_web.untrusted import TextMarker, speaks

__all__ = ["PLAN", "ROBOTS", "STOP", "skills_of"]

Node = dict[str, Any]
_PAGE = 1000
_STEP = 16  # skills that are described at once: a millisecond
_SHOWN = 8  # parameters listed in a description

PLAN = AgentSkill(
    id="plan",
    name="Run a plan",
    description=(
        "Checks all of a plan, then runs it as one task. A plan is a data part with JSON (steps of "
        "read, write and execute, in sequence or parallel, with conditions, retries and "
        "fallbacks), or a text part: the symbolic plan of a PDDL planner, or lines of commands. "
        "With `dry_run` in the message's metadata the plan is only checked."
    ),
    tags=["plan", "robot"],
)
_NO_PLANS = (
    "Not with your rights: every message would be rejected. Use credentials with a role that may "
    "execute /system/plans; the card then lists what they allow."
)
STOP = AgentSkill(
    id="stop",
    name="Emergency stop",
    description=(
        "Stops robots at once, ahead of every queue, and latches them until a person with the right "
        "resets it. `scope` is a robot (its backend's name, or /tenant/<tenant>/<robot>), a group "
        "by its name, or a tenant (/tenant/<tenant>); without it every robot that you may stop. "
        "The task completes only when each of them is measured at rest. Otherwise it fails with "
        "device_timeout, and `details.robots` of the error gives the state of each stop: tell a "
        "person to use the robot's own emergency stop. To pause a robot without a latch, execute "
        "its /service/hold."
    ),
    tags=["stop", "safety"],
    examples=[
        'execute /system/estop {"reason": "person in the cell"}',
        '{"steps": [{"do": "execute", "path": "/system/estop", "value": {}}]}',
    ],
)
ROBOTS = AgentSkill(
    id="robots",
    name="List the robots",
    description=(
        "Lists the robots that you may see: path, kind, profiles, state, mode, battery, position, "
        "limits, and who has control. The path of a robot (/tenant/<tenant>/<robot>) is the scope "
        "of a stop; its resources are /tenant/<tenant>/<branch>/<robot>/<name>."
    ),
    tags=["inventory", "robot"],
    examples=[
        '{"steps": [{"do": "read", "path": "/system/robots"}]}',
        "read /system/robots",
    ],
)
_MAY = Query(op="execute", limit=1)
_OF_SYSTEM = (
    (STOP, "/system/estop", _MAY),
    (ROBOTS, "/system/robots", Query(op="read", limit=1)),
)
"""Skills with the resource that they need."""


def skills_of(
    client_api: ClientApi, session: Session | None, marker: TextMarker
) -> Generator[None, None, list[AgentSkill]]:
    """List what a session may execute in its tenant, in steps; without one, only general skills.

    A task runs a plan: a session that may not run plans can do nothing here, and its card says so.
    """
    if session is None:
        return [_plan_skill()]
    plans = yield from client_api.discover(session, "/system/plans", _MAY)
    if not plans["resources"]:
        return [_plan_skill(_NO_PLANS)]
    found: list[AgentSkill] = []
    for skill, path, query in _OF_SYSTEM:
        page = yield from client_api.discover(session, path, query)
        if page["resources"]:
            found.append(skill)
    if session.tenant is not None:
        root = f"/tenant/{session.tenant}"
        found += yield from _of_tenant(client_api, session, root, marker)
    examples = [one for skill in reversed(found) if skill is not STOP for one in skill.examples]
    return [_plan_skill(examples=examples[:2]), *found]


def _plan_skill(note: str = "", examples: Sequence[str] = ()) -> AgentSkill:
    skill = AgentSkill()
    skill.CopyFrom(PLAN)
    skill.examples.extend(examples)
    if note:
        skill.description = f"{note} {PLAN.description}"
    return skill


def _of_tenant(
    client_api: ClientApi, session: Session, root: str, marker: TextMarker
) -> Generator[None, None, list[AgentSkill]]:
    """List a tenant's actions and services, in steps."""
    found: list[AgentSkill] = []
    cursor: str | None = None
    while True:
        query = Query(op="execute", limit=_PAGE, cursor=cursor)
        page = yield from client_api.discover(session, f"{root}/**", query)
        for number, resource in enumerate(page["resources"], 1):
            found.append(_skill(resource, root, marker))
            if not number % _STEP:
                yield
        cursor = page.get("cursor")
        if cursor is None:
            return found


def _skill(resource: Node, root: str, marker: TextMarker) -> AgentSkill:
    """Describe one action or service; a robot may have written its description and its schema."""
    short = resource["path"].removeprefix(root)
    kind, *names = short.strip("/").split("/")
    examples = resource["examples"][:2] or _inputs(resource["schemas"].get("input"))
    examples = [one for one in examples if not speaks(msgspec.to_builtins(one))]
    return AgentSkill(
        id=".".join((kind, *names)),
        name=" ".join(names).replace("_", " "),
        description=marker.text(
            resource["description"] + _parameters(resource["schemas"].get("input"))
        ),
        tags=[kind, *names[:-1], *(one.partition("/")[0] for one in resource.get("profiles", ()))],
        examples=[
            *(_plan(short, value) for value in examples),
            *(_line(short, value) for value in examples[:1]),
        ],
    )


def _inputs(schema: Node | None) -> list[Any]:
    """Return an input that fits a schema, if there is one that is as good as any other."""
    if schema is None:
        return [None]
    try:
        return [_input(schema, schema.get("$defs", {}))]
    except LookupError:
        return []


def _input(schema: Node, defs: Node) -> Any:
    """Return the plainest value that fits a schema.

    :raises LookupError: none can be known, such as a name.
    """
    if {"type": "null"} in schema.get("anyOf", ()):
        return None
    node = _followed(schema, defs)
    for key in ("default", "const"):
        if key in node:
            return node[key]
    if "enum" in node:
        return node["enum"][0]
    match node.get("type"):
        case "number" | "integer":
            low, high = node.get("minimum", 0), node.get("maximum", 0)
            value = min(max(0, low), max(high, low))
            if value == node.get("exclusiveMinimum") or value == node.get("exclusiveMaximum"):
                raise LookupError
            return value
        case "boolean":
            return False
        case "object":
            fields: Node = node.get("properties") or {}
            return {name: _input(fields[name], defs) for name in node.get("required", ())}
        case _:
            raise LookupError


def _plan(path: str, value: Any) -> str:
    step: Node = {"do": "execute", "path": path}
    if value is not None:
        step["value"] = value
    return msgspec.json.encode({"steps": [step]}).decode()


def _line(path: str, value: Any) -> str:
    given = "" if value is None else f" {msgspec.json.encode(value).decode()}"
    return f"execute {path}{given}"


def _parameters(schema: Node | None) -> str:
    """Describe the parameters of an input: names, units and bounds."""
    defs: Node = (schema or {}).get("$defs", {})
    node = _followed(schema or {}, defs)
    fields: Node = node.get("properties") or {}
    if not fields:
        plain = _range(node) or (node.get("type") if node.get("type") != "object" else None)
        return f" Input: {plain}." if plain else " Takes no input."
    needed = set(node.get("required", ()))
    lines = [
        " ".join(
            word
            for word in (name, "(needed)" if name in needed else "", _range(_followed(field, defs)))
            if word
        )
        for name, field in list(fields.items())[:_SHOWN]
    ]
    return f" Input: {', '.join(lines)}."


def _followed(schema: Node, defs: Node) -> Node:
    """Resolve references, and drop alternatives for null."""
    options = [one for one in schema.get("anyOf", ()) if one.get("type") != "null"]
    if len(options) == 1:
        return _followed(options[0], defs)
    return defs.get(schema["$ref"].rpartition("/")[2], {}) if "$ref" in schema else schema


def _range(schema: Node) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    bounds = "" if low is None and high is None else f"{_or(low, '…')} to {_or(high, '…')}"
    unit = schema.get("unit", "1")
    return bounds if unit == "1" else f"{bounds} {unit}".strip()


def _or(value: Any, other: str) -> str:
    return other if value is None else f"{value:g}"
