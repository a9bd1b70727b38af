"""Display of the gateway's replies, and parsing of the special options of `watch`."""

from __future__ import annotations

import time
from typing import Any

import click

from rcp_client.console.outline import outline
from rcp_client.console.output import Output, clean, compact, pretty
from rcp_client.messages import Reply, ResourceInfo, Update
from rcp_protocol.errors import BadRequest
from rcp_protocol.values import Encoding, parse

__all__ = [
    "approvals",
    "commands",
    "estop",
    "item",
    "json_object",
    "latched_line",
    "number_or_json",
    "number_or_text",
    "reply",
    "resource",
    "resources",
    "robot_charge",
    "robot_controller",
    "robot_state",
    "status",
    "update",
    "value",
    "value_facts",
]


def resources(out: Output, found: list[ResourceInfo]) -> None:
    """Show resources as a table."""
    rows = [(r.path, r.kind, ",".join(r.operations), r.state, r.description) for r in found]
    out.table(("PATH", "KIND", "OPERATIONS", "STATE", "DESCRIPTION"), rows)


def resource(out: Output, found: ResourceInfo) -> None:
    """Show all details of one resource."""
    out.line(f"{found.path}  {out.paint(found.state or '')}".rstrip())
    out.line(clean(found.description))
    rows = [("kind", found.kind), ("operations", ", ".join(found.operations))]
    names = ("unit", "backend", "deadline", "timeout", "policy", "max_age", "valid_for", "atomic")
    rows += [(n, str(fact)) for n in names if (fact := getattr(found, n)) is not None]
    for name, fact in rows:
        out.line(f"  {name:<11} {clean(fact)}")
    for name, schema in found.schemas.items():
        out.line(f"{name}  {out.dim(found.schema_ids.get(name, ''))}".rstrip())
        out.rows([("  " + field, type_, note) for field, type_, note in outline(schema)])
    for example in found.examples:
        out.line(f"example  {compact(example)}")


def approvals(out: Output, listed: list[dict[str, Any]]) -> None:
    """Show approvals with the values that would be sent."""
    rows = [
        (a["approval"], out.paint(a["status"]), a["principal"], a["request"], a["path"],
         a["expires"][11:19], compact(a.get("value")))
        for a in listed
    ]  # fmt: skip
    out.table(("ID", "STATUS", "BY", "WANTS TO", "PATH", "UNTIL", "VALUE"), rows)


def value_facts(reply: Reply) -> dict[str, Any]:
    """Return the fields of a read reply that matter to users."""
    facts = {
        "path": reply.path,
        "status": reply.status,
        "body": reply.body,
        "seq": reply.seq,
        "timestamp": reply.source_timestamp,
        "state": reply.state,
    }
    return {key: fact for key, fact in facts.items() if fact is not None or key == "body"}


def value(out: Output, reply: Reply, *, several: bool) -> None:
    """Show the value of a read; its state and time too if there are several values."""
    if several or reply.state == "stale":
        seq = "" if reply.seq is None else f"#{reply.seq}"
        facts = out.dim(f"{seq} {reply.source_timestamp or ''}".strip())
        out.line(f"{reply.path}  {out.paint(reply.state or '')}  {facts}")
    out.line(pretty(reply.body))


def item(out: Output, found: dict[str, Any]) -> int:
    """Show one item of a pattern read; return its exit status."""
    failed = found.get("status") != "completed"
    if out.json:
        out.document(found)
    elif failed:
        error = found.get("error") or {}
        out.line(f"{found['path']}  {out.paint(found['status'])}  {clean(error['message'])}")
    else:
        out.line(f"{found['path']}  {compact(found.get('body'))}")
    return 0 if not failed else 3 if found["status"] == "rejected" else 1


def reply(out: Output, found: Reply) -> None:
    """Show a final reply."""
    if out.json:
        names = ("type", "path", "status", "command", "message", "dry_run", "seq", "timestamp")
        facts = {name: fact for name in names if (fact := getattr(found, name))}
        out.document({**facts, "body": found.body})
        return
    out.line(f"{out.paint(found.status)} {clean(found.message or '')}".rstrip())
    if found.body not in (None, {}):
        out.line(pretty(found.body))


def update(out: Output, found: Update) -> None:
    """Show one update on one line."""
    if out.json:
        out.document(found)
        return
    skipped = f"  ({found.dropped} skipped)" if found.dropped else ""
    moment = found.timestamp[11:23]
    value = compact(found.body)
    if found.truncated:
        value = out.dim(f"<{found.size} bytes: rcpctl read {found.path}>")
    out.line(f"{out.dim(moment)} {found.path} {out.dim(f'#{found.seq}')} {value}{out.dim(skipped)}")


_SEVERAL = 3  # robots that one line names


def status(out: Output, report: dict[str, Any]) -> None:
    """Show the health report."""
    if out.json:
        out.document(report)
        return
    uptime = _span(report.get("uptime") or 0)
    out.line(f"{out.paint(str(report.get('state')))}  version {report.get('version')}  up {uptime}")
    process = report.get("process") or {}
    running = report.get("commands") or {}
    out.line(
        f"cpu {_number(process.get('cpu'))} %  memory {(process.get('rss') or 0) / 1e6:.0f} MB  "
        f"sessions {report.get('sessions')}  subscriptions {report.get('subscriptions')}  "
        f"commands {running.get('running')} running, {running.get('queued')} queued"
    )
    backends = report.get("backends") or []
    if backends:
        out.line()
        names = ("name", "plugin", "tenant", "state", "resources", "detail")
        rows = [[backend.get(name) for name in names] for backend in backends]
        out.table([name.upper() for name in names], rows)
    for record in (report.get("warnings") or [])[-5:]:
        out.line(out.dim(clean(f"{record.get('timestamp')} {logged(record)}")))


def logged(record: dict[str, Any]) -> str:
    """Return what a record of the log says, without its time."""
    facts = "".join(f" {name}={fact}" for name, fact in (record.get("facts") or {}).items())
    return f"{record.get('level')}: {record.get('message')}{facts}"


def commands(out: Output, listed: list[dict[str, Any]]) -> None:
    """Show commands as a table."""
    rows = [
        (
            command["command"],
            command["status"],
            "" if command.get("progress") is None else f"{command['progress']:.0%}",
            command["created"][:19],
            command.get("principal"),
            command["path"],
            command.get("message", ""),
        )
        for command in listed
    ]
    out.table(("COMMAND", "STATUS", "DONE", "CREATED", "BY", "PATH", "MESSAGE"), rows)


def robots(out: Output, listed: list[dict[str, Any]]) -> None:
    """Show robots as a table."""
    rows = [
        (
            robot["path"],
            robot.get("kind") or "",
            robot_state(robot),
            robot.get("mode") or "",
            robot_charge(robot),
            robot_controller(robot),
            " ".join(robot.get("profiles", ())),
        )
        for robot in listed
    ]
    out.table(("ROBOT", "KIND", "STATE", "MODE", "BATTERY", "CONTROL", "PROFILES"), rows)


def robot_state(robot: dict[str, Any]) -> str:
    """Return the state of a robot, with its latch or hold."""
    marks = [name for name in ("estop", "held") if robot.get(name)]
    if marks and robot["state"] == "ready":
        return ", ".join(marks)
    return ", ".join((*marks, robot["state"]))


def robot_charge(robot: dict[str, Any]) -> str:
    """Return the charge of a robot's battery."""
    battery = robot.get("battery") or {}
    percentage = battery.get("value", {}).get("percentage")
    if percentage is None:
        return ""
    return f"{percentage:.0%}" + (" (stale)" if battery.get("stale") else "")


def robot_controller(robot: dict[str, Any]) -> str:
    """Return who has control of a robot."""
    control = robot.get("control")
    return "" if control is None else f"{control['principal']} ({control['by']})"


def leases(out: Output, listed: list[dict[str, Any]]) -> None:
    """Show leases as a table."""
    rows = [
        (
            lease["scope"],
            lease["holder"],
            lease.get("session") or "",
            lease["priority"],
            lease["expires"][:19],
            lease.get("reason") or "",
        )
        for lease in listed
    ]
    out.table(("SCOPE", "HOLDER", "SESSION", "PRIORITY", "UNTIL", "REASON"), rows)


def lease(out: Output, facts: dict[str, Any]) -> None:
    """Show one lease."""
    if out.json:
        out.document(facts)
    else:
        out.line(
            f"{facts['holder']} holds the lease on {facts['scope']} until {facts['expires'][:19]}Z."
        )


def estop(out: Output, state: dict[str, Any]) -> None:
    """Show which robots are stopped, and the progress of each stop."""
    robots: dict[str, dict[str, Any]] = state.get("robots") or {}
    scopes = state.get("scopes") or {}
    if not robots and not scopes:
        out.line("E-stop reset. Nothing moves until a new command.")
        return
    names = sorted(robots) or sorted(scopes)
    out.line(f"E-stop {out.paint('latched')}: {', '.join(names)}.")
    rows = [
        (
            name,
            "alarm" if robot.get("alarm") else robot["state"],
            *(_clock(robot.get(step)) for step in ("requested", "commanded", "confirmed")),
            _why(robot),
        )
        for name, robot in sorted(robots.items())
        if "state" in robot  # older gateways report only which robots are latched
    ]
    if rows:
        head = ("ROBOT", "STATE", "REQUESTED", "COMMANDED", "CONFIRMED", "DETAIL")
        out.table(head, rows)


def latched(out: Output, state: dict[str, Any]) -> None:
    """Show on one line what is stopped, by whom, since when and why; nothing if nothing is."""
    line = latched_line(state)
    if line is not None:
        out.line(line.replace("latched", out.paint("latched"), 1))


def latched_line(state: dict[str, Any]) -> str | None:
    """Return this line, or None."""
    stops: dict[str, dict[str, Any]] = state.get("robots") or state.get("scopes") or {}
    if not stops:
        return None
    names = sorted(stops)
    first = stops[names[0]]
    shown = ", ".join(names[:_SEVERAL])
    more = f" and {len(names) - _SEVERAL} more" if len(names) > _SEVERAL else ""
    why = f" ({first['reason']})" if first.get("reason") else ""
    whose = clean(f"by {first.get('by')} since {str(first.get('since'))[:19]}{why}")
    return f"E-stop latched: {clean(shown)}{more}, {whose}. To reset it: rcpctl estop --reset"


def confirmed(robot: dict[str, Any]) -> bool:
    """Return whether a latched robot is confirmed at rest, and has not moved since."""
    return robot.get("state", "confirmed") == "confirmed" and not robot.get("alarm")


def _why(robot: dict[str, Any]) -> str:
    moved = "moves again under the latch" if robot.get("alarm") else ""
    return ": ".join(part for part in (moved, robot.get("detail")) if part)


def _clock(moment: str | None) -> str:
    return "-" if moment is None else moment[11:23]


def holds(out: Output, outcomes: list[dict[str, Any]]) -> None:
    """Show which robots are at rest after a hold."""
    rows = [
        (one["robot"], "at rest" if one["at_rest"] else "not at rest", one.get("detail") or "")
        for one in outcomes
    ]
    out.table(("ROBOT", "STATE", "DETAIL"), rows)


def _span(seconds: float) -> str:
    days, rest = divmod(int(seconds), 86_400)
    return (f"{days} d " if days else "") + time.strftime("%H:%M:%S", time.gmtime(rest))


def _number(number: Any) -> str:
    return f"{number:.0f}" if isinstance(number, (int, float)) else "?"


def number_or_text(text: str | None) -> int | str | None:
    """Parse `--history`: a number of samples, or a time span such as `30s`."""
    return int(text) if text is not None and text.isdigit() else text


def number_or_json(text: str | None, option: str) -> Any:
    """Parse `--deadband`: a number, `5%`, or a JSON map."""
    if text is None or text.endswith("%"):
        return text
    return _json(text, option)


def json_object(text: str | None, option: str) -> dict[str, Any] | None:
    """Parse an option that is a JSON object."""
    if text is None:
        return None
    found = _json(text, option)
    if not isinstance(found, dict):
        raise click.UsageError(f"{option} must be a JSON object")
    return found


def _json(text: str, option: str) -> Any:
    try:
        return parse(text.encode(), Encoding.JSON)
    except BadRequest as error:
        raise click.UsageError(f"{option}: {error.message}") from error
