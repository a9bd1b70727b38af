"""`rcpctl triggers` and `rcpctl alarms`."""

from __future__ import annotations

from typing import Any

from rcp_client.client import Client
from rcp_client.console import show
from rcp_client.console.output import Output, compact
from rcp_client.console.value import meant

__all__ = [
    "acknowledge",
    "add_trigger",
    "list_alarms",
    "list_triggers",
    "remove_trigger",
    "test_trigger",
]

_TRIGGERS, _ALARMS = "/system/triggers", "/system/alarms"
_FAILED = 1
_OPEN = ("active", "acknowledged", "cleared")
_TRIGGER_HEAD = ("TRIGGER", "ROBOT", "STATE", "CONDITION", "FIRINGS", "LAST", "BY", "DETAIL")
_ALARM_HEAD = ("ALARM", "STATE", "SEVERITY", "ROBOT", "RAISED", "COUNT", "BY", "MESSAGE")
_TEST_HEAD = ("ROBOT", "CONDITION", "VALUES", "WOULD", "DETAIL")


async def list_triggers(client: Client, out: Output, _: dict[str, Any]) -> int:
    """List triggers on each of their robots."""
    listed = await client.read(_TRIGGERS)
    if out.json:
        for one in listed:
            out.document(one)
    elif listed:
        out.table(_TRIGGER_HEAD, [row for one in listed for row in _rows(one)])
    else:
        out.aside("No triggers.")
    return 0


def _rows(trigger: dict[str, Any]) -> list[tuple[Any, ...]]:
    name, by = trigger["trigger"], trigger.get("by") or "configuration"
    stopped = trigger.get("stopped")
    robots = trigger.get("robots") or []
    if not robots:
        return [(name, trigger["spec"]["robot"], "no robot", "", 0, "", by, stopped)]
    return [
        (
            name,
            robot["robot"],
            "stopped" if stopped else robot["state"],
            robot["condition"],
            robot.get("firings", 0),
            (robot.get("fired") or "")[:19],
            by,
            stopped or _why(robot),
        )
        for robot in robots
    ]


def _why(robot: dict[str, Any]) -> str:
    if robot.get("limited"):
        return f"too many firings: {robot['suppressed']} suppressed"
    unknown = [f"{name}: {why}" for name, why in (robot.get("unknown") or {}).items()]
    outcome = robot.get("outcome")
    if outcome not in (None, "completed"):
        unknown.append(f"command {outcome}: {robot.get('detail') or ''}")
    return "; ".join(unknown)


async def add_trigger(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Create a trigger from the options."""
    spec: dict[str, Any] = {"name": args["trigger"], "robot": args["robot"], "when": args["when"]}
    names = ("clear", "on", "repeat", "cool_down", "message", "severity", "notify_cleared")
    names += ("alarm", "incident", "notify")
    spec |= {name: args[name] for name in names if args[name]}
    if args["held"]:
        spec["for"] = args["held"]
    if args["execute"] is not None:
        spec["execute"] = {"path": args["execute"]}
        if args["value"] is not None:
            spec["execute"]["value"] = await meant(client, args["execute"], args["value"])
    envelope: dict[str, Any] = {"type": "execute", "path": _TRIGGERS, "body": {"add": spec}}
    if args["dry_run"]:
        envelope["dry_run"] = True
    show.reply(out, await client.request(envelope))
    return 0


async def remove_trigger(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Remove a trigger."""
    envelope = {"type": "execute", "path": _TRIGGERS, "body": {"remove": args["trigger"]}}
    show.reply(out, await client.request(envelope))
    return 0


async def test_trigger(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Show what a trigger would do now; fail if it could not."""
    found = await client.execute(_TRIGGERS, {"test": args["trigger"]})
    robots = found.get("robots") or []
    if out.json:
        out.document(found)
    else:
        out.table(_TEST_HEAD, [_tested(robot) for robot in robots])
    return _FAILED if any(robot.get("refused") for robot in robots) else 0


def _tested(robot: dict[str, Any]) -> tuple[Any, ...]:
    values = ", ".join(f"{n} = {compact(v)}" for n, v in (robot.get("values") or {}).items())
    unknown = "; ".join(f"{n}: {why}" for n, why in (robot.get("unknown") or {}).items())
    would = ", ".join(robot.get("would") or [])
    return robot["robot"], robot["condition"], values, would, robot.get("refused") or unknown


async def list_alarms(client: Client, out: Output, args: dict[str, Any]) -> int:
    """List alarms, newest first."""
    listed = await client.read(_ALARMS)
    if not args["every"]:
        listed = [one for one in listed if one["state"] in _OPEN]
    if out.json:
        for one in listed:
            out.document(one)
    elif listed:
        out.table(_ALARM_HEAD, [_alarm(one) for one in listed])
    else:
        out.aside("No alarms.")
    return 0


def _alarm(alarm: dict[str, Any]) -> tuple[Any, ...]:
    comment = f" ({alarm['comment']})" if alarm.get("comment") else ""
    return (
        alarm["alarm"],
        alarm["state"],
        alarm["severity"],
        alarm["robot"],
        alarm["raised"][:19],
        alarm.get("count", 1),
        alarm.get("by") or "",
        alarm["message"] + comment,
    )


async def acknowledge(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Acknowledge alarms."""
    for id_ in args["alarms"]:
        body = {"acknowledge": id_, "comment": args["comment"] or ""}
        alarm = await client.execute(_ALARMS, body)
        if out.json:
            out.document(alarm)
        else:
            out.line(f"{alarm['alarm']} is {alarm['state']}: {alarm['message']}")
    return 0
