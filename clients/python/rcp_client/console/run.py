"""The subcommands of `rcpctl`, after the command line is parsed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import click

from rcp_client.client import Client
from rcp_client.console import mcp, record, replay, show, triggers, unwaited, whole
from rcp_client.console.execute import execute
from rcp_client.console.fleet import fleet
from rcp_client.console.gateway import named_gateway
from rcp_client.console.nearest import with_nearest
from rcp_client.console.output import Output, exit_code
from rcp_client.console.plan import plan
from rcp_client.console.plot import plot
from rcp_client.console.repetition import repeat
from rcp_client.console.stops import estop, estop_without_session, hold
from rcp_client.console.top import top
from rcp_client.console.value import fetch, meant
from rcp_client.errors import ConnectionLost
from rcp_client.messages import Notice, Update
from rcp_protocol.errors import QueueFull, RcpError

__all__ = ["run"]

_PATIENCE = 30.0  # s without a connection before a command gives up
_FAILED = 1
_PAIR = 2
_HUNG = 2.0  # s for the connection of an e-stop, before it is sent by HTTP
Arguments = dict[str, Any]


def run(name: str, options: dict[str, Any], arguments: Arguments) -> int:
    """Connect, run a subcommand, and return the exit status."""
    out = Output(options.get("shown_as"))
    timeout = options.get("timeout", 10.0)
    for key in ("value", "input"):
        if isinstance(arguments.get(key), str):
            arguments[key] = fetch(arguments[key])
    try:
        within = min(_HUNG if name == "estop" else 5.0, timeout)
        client = named_gateway(options, deadline=timeout, within=within, patience=_PATIENCE)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    try:
        try:
            return unwaited.run(_run(client, out, _COMMANDS[name], arguments))
        except (ConnectionLost, QueueFull) as error:
            if name != "estop" or arguments["reset"]:
                raise
            out.aside(f"rcpctl: {error.message}; stopping by HTTP.")
            # Stopping twice does no harm, and plain HTTP needs no session.
            return unwaited.run(estop_without_session(client, out, arguments))
    except RcpError as error:
        out.error(error)
        return exit_code(error)


async def _run(
    client: Client,
    out: Output,
    command: Callable[[Client, Output, Arguments], Awaitable[int]],
    arguments: Arguments,
) -> int:
    async with client:
        try:
            return await command(client, out, arguments)
        except RcpError as error:
            await with_nearest(client, error)
            raise


async def _discover(client: Client, out: Output, args: Arguments) -> int:
    wanted = {name: args[name] for name in ("kind", "op", "q", "profile")}
    found = await client.discover(args["pattern"], **wanted)
    if out.json:
        for resource in found:
            out.document(resource)
        return 0
    pattern = args["pattern"] or ""
    if len(found) == 1 and pattern and "*" not in pattern:
        show.resource(out, found[0])
    elif found:
        show.resources(out, found)
    else:
        out.aside("Nothing matches.")
    return 0


async def _read(client: Client, out: Output, args: Arguments) -> int:
    code = 0
    for path in args["paths"]:
        options = {name: args[name] for name in ("fields", "fresh", "frame")}
        try:
            if "*" in path:
                async for items in client.pages(path, **options):
                    code = max([code, *(show.item(out, item) for item in items)])
                continue
            reply = await client.sample(path, **options)
        except RcpError as error:
            out.error(await with_nearest(client, error))
            code = max(code, exit_code(error))
            continue
        if out.json:
            out.document(show.value_facts(reply))
        else:
            show.value(out, reply, several=len(args["paths"]) > 1)
    return code


async def _write(client: Client, out: Output, args: Arguments) -> int:
    envelope: dict[str, Any] = {"type": "write", **await _targets(client, args["words"])}
    optional = {
        "valid_for": args["valid_for"],
        "idempotency_key": args["key"],
        "approval": args["approval"],
    }
    envelope |= {key: item for key, item in optional.items() if item is not None}
    if args["dry_run"]:
        envelope["dry_run"] = True
    show.reply(out, await client.request(envelope))
    return 0


async def _targets(client: Client, words: Sequence[str]) -> dict[str, Any]:
    """Return `path` and `body` of a write; without a path for several as one."""
    if "=" in words[0]:  # which no path contains
        pairs = [word.partition("=") for word in words]
        wrong = next(
            (word for word, (_, sign, _) in zip(words, pairs, strict=True) if not sign), ""
        )
        if wrong:
            raise click.UsageError(f"{wrong!r} is not PATH=VALUE")
        values = {path: await meant(client, path, fetch(text)) for path, _, text in pairs}
        if len(values) < len(pairs):
            raise click.UsageError("a path is given twice")
        return {"body": values}
    if len(words) != _PAIR:
        raise click.UsageError("give PATH VALUE, or PATH=VALUE for each of several paths")
    path, text = words
    return {"path": path, "body": await meant(client, path, fetch(text))}


async def _watch(client: Client, out: Output, args: Arguments) -> int:
    subscription = client.subscribe(
        args["patterns"],
        rate=args["rate"],
        on="change" if args["change"] else None,
        deadband=show.number_or_json(args["deadband"], "--deadband"),
        where=show.json_object(args["where"], "--where"),
        fields=args["fields"],
        frame=args["frame"],
        history=show.number_or_text(args["history"]),
        initial=None if args["initial"] else False,
        reliable=args["reliable"],
        duration=args["duration"],
        count=args["count"],
        on_notice=lambda notice: _noticed(out, notice),
    )
    async with subscription:
        if not subscription.paths:
            out.aside("No matching resource yet; waiting.")
        async for update in subscription:
            show.update(out, update)
    return 0


def _noticed(out: Output, notice: Notice) -> None:
    if notice.code != "subscription_ended":
        about = f" {notice.path}" if notice.path else ""
        out.aside(f"rcpctl: {notice.code}{about}{': ' + notice.message if notice.message else ''}")


async def _status(client: Client, out: Output, args: Arguments) -> int:
    if not args["watch"]:
        report = await client.status()
        await _latched(client, out)
        show.status(out, report)
        return 0
    on_notice: Callable[[Notice], None] = lambda notice: _noticed(out, notice)  # noqa: E731
    async for update in client.subscribe("/system/status", rate=1, on_notice=on_notice):
        if isinstance(update, Update):
            if out.terminal and not out.json:
                out.line("\x1b[H\x1b[2J\x1b[3J")
            await _latched(client, out)
            show.status(out, update.body)
    return 0


async def _latched(client: Client, out: Output) -> None:
    """Begin the status with an e-stop that is latched; a role may not be allowed to see it."""
    if not out.json:
        with suppress(RcpError):
            show.latched(out, await client.read("/system/estop"))


async def _commands(client: Client, out: Output, args: Arguments) -> int:
    listed = await client.commands()
    if args["running"]:
        listed = [command for command in listed if "finished" not in command]
    if out.json:
        for command in listed:
            out.document(command)
    elif listed:
        show.commands(out, listed)
    else:
        out.aside("No commands.")
    return 0


async def _cancel(client: Client, out: Output, args: Arguments) -> int:
    named = "path" if args["command"].startswith("/") else "command"
    show.reply(out, await client.request({"type": "cancel", named: args["command"]}))
    return 0


async def _approvals(client: Client, out: Output, args: Arguments) -> int:
    listed = await client.approvals()
    if not args["every"]:
        listed = [one for one in listed if one["status"] in ("pending", "approved")]
    if out.json:
        for one in listed:
            out.document(one)
    elif listed:
        show.approvals(out, listed)
    else:
        out.aside("No commands are waiting for approval.")
    return 0


async def _approve(client: Client, out: Output, args: Arguments) -> int:
    state = await client.approve(args["approval"], reject=args["reject"], reason=args["reason"])
    if out.json:
        out.document(state)
    else:
        show.approvals(out, [state])
    return 0


async def _robots(client: Client, out: Output, args: Arguments) -> int:
    listed = await client.robots(" ".join(args["text"]))
    if out.json:
        for robot in listed:
            out.document(robot)
    elif listed:
        show.robots(out, listed)
    else:
        out.aside("No robots.")
    return 0


async def _lease_list(client: Client, out: Output, _: Arguments) -> int:
    listed = await client.leases()
    if out.json:
        for lease in listed:
            out.document(lease)
    elif listed:
        show.leases(out, listed)
    else:
        out.aside("No leases.")
    return 0


async def _lease_acquire(client: Client, out: Output, args: Arguments) -> int:
    names = ("ttl", "take", "reason")
    body = {name: args[name] for name in names if args[name]}
    return await _lease_whole(client, out, {"do": "acquire", "scope": args["scope"], **body})


async def _lease_release(client: Client, out: Output, args: Arguments) -> int:
    return await _lease_whole(client, out, {"do": "release", "scope": args["scope"]})


async def _lease_whole(client: Client, out: Output, body: dict[str, Any]) -> int:
    if not body["scope"].startswith("/tenant/"):
        body["scope"] = f"/tenant/{client.greeting.get('tenant')}{body['scope']}"
    envelope = {"type": "execute", "path": "/system/leases", "body": body}
    facts = (await whole.request(client, envelope)).body
    if out.json or body["do"] == "acquire":
        show.lease(out, facts)
    else:
        out.line(f"{facts['scope']} is free.")
    return 0


async def _lease_hold(client: Client, out: Output, args: Arguments) -> int:
    lease = client.lease(args["scope"], ttl=args["ttl"], take=args["take"], reason=args["reason"])
    async with lease:
        show.lease(out, lease.facts)
        out.aside("Lease held. Press Ctrl-C to release it.")
        await asyncio.Event().wait()
    return 0


async def _codegen(client: Client, out: Output, args: Arguments) -> int:
    from rcp_client.codegen import generate

    found = await client.discover(args["pattern"] or "/**")
    if not found:
        out.aside("rcpctl: no resources to generate a client for.")
        return _FAILED
    out.line(generate(args["lang"], found, client.settings.address.url).rstrip("\n"))
    return 0


_Command = Callable[[Client, Output, Arguments], Awaitable[int]]


def _listing(command: _Command) -> _Command:
    """Let `--watch` repeat a listing."""

    async def run(client: Client, out: Output, args: Arguments) -> int:
        if not args["watch"]:
            return await command(client, out, args)
        return await repeat(out, partial(command, client, out, args))

    return run


_COMMANDS: dict[str, _Command] = {
    "discover": _listing(_discover),
    "read": _listing(_read),
    "write": _write,
    "execute": execute,
    "plan": plan,
    "watch": _watch,
    "plot": plot,
    "status": _status,
    "top": top,
    "commands": _listing(_commands),
    "cancel": _cancel,
    "estop": estop,
    "hold": hold,
    "approvals": _listing(_approvals),
    "approve": _approve,
    "robots": _listing(_robots),
    "fleet": _listing(fleet),
    "lease list": _listing(_lease_list),
    "lease acquire": _lease_acquire,
    "lease release": _lease_release,
    "lease hold": _lease_hold,
    "triggers list": triggers.list_triggers,
    "triggers add": triggers.add_trigger,
    "triggers remove": triggers.remove_trigger,
    "triggers test": triggers.test_trigger,
    "alarms list": triggers.list_alarms,
    "alarms ack": triggers.acknowledge,
    "mcp tools": mcp.tools,
    "record list": record.listed,
    "record start": record.start,
    "record stop": record.stop,
    "record pin": record.pin,
    "record unpin": record.unpin,
    "record download": record.fetch,
    "record history": record.history,
    "replay": replay.replay,
    "codegen": _codegen,
}
