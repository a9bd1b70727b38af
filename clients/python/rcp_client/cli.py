"""`rcpctl`: the command-line client of a gateway, for terminals and shell scripts.

Only command line parsing is imported here; the client is imported when a command runs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import click

__all__ = ["main"]

F = TypeVar("F", bound=Callable[..., Any])

_USAGE = 2
_INTERRUPTED = 130
_CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
# `write PATH -0.5` is a value, not an option.
_WITH_VALUE = {**_CONTEXT, "ignore_unknown_options": True}


def _keep(ctx: click.Context, param: click.Parameter, value: Any) -> None:
    """Store an option shared by all commands; the last one on the command line wins."""
    if value is not None and param.name is not None:
        ctx.ensure_object(dict)[param.name] = value


def _shared(*names: str, **facts: Any) -> Callable[[F], F]:
    return click.option(*names, expose_value=False, callback=_keep, **facts)


def _common(function: F) -> F:
    """Add the options that may precede or follow the subcommand."""
    options = (
        _shared(
            "--url",
            metavar="URL",
            help="Gateway, or several with commas [RCP_URL; http://127.0.0.1:8080].",
        ),
        _shared("--token", metavar="TEXT", help="API key or JWT [RCP_TOKEN; rcpd demo's]."),
        _shared("--tenant", metavar="NAME", help="Tenant for relative paths [RCP_TENANT]."),
        _shared(
            "--cacert",
            metavar="FILE",
            help="CA certificate that signed the gateway's certificate [RCP_CACERT].",
        ),
        _shared("--cert", metavar="FILE", help="Client certificate [RCP_CERT]."),
        _shared(
            "--cert-key",
            "client_key",
            metavar="FILE",
            help="Key of the client certificate [RCP_KEY].",
        ),
        _shared(
            "--plaintext",
            is_flag=True,
            default=None,
            help="Allow sending the token over plain http to another machine.",
        ),
        _shared(
            "--timeout",
            type=click.FloatRange(0, min_open=True),
            metavar="SECONDS",
            help="Time limit for a reply [10].",
        ),
        _shared(
            "--json/--text",
            "json",
            default=None,
            help="One JSON document per line, or text [text on a terminal, else JSON].",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def _run(ctx: click.Context, name: str, **arguments: Any) -> int:
    from rcp_client.console.run import run

    try:
        return run(name, ctx.ensure_object(dict), arguments)
    except BrokenPipeError:  # the reader has closed the pipe, as in `rcpctl watch … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


@click.group(context_settings=_CONTEXT)
@_common
@click.version_option(package_name="rcp-gateway", message="rcpctl %(version)s")
def rcpctl() -> None:
    """Read, write, command and watch robots through an RCP gateway.

    PATH is the path of a resource; without /tenant/<name> it refers to your own tenant. In a
    PATTERN, * is one segment and ** any number. A VALUE or INPUT is JSON, or plain text if the
    path expects a string; - reads it from standard input, @FILE from a file.

    Exit status: 0 completed, 1 failed (or a robot is not at rest), 2 usage, 3 rejected or denied,
    4 gateway unreachable (1 if what was sent may have been executed), 130 interrupted.
    """


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("pattern", required=False)
@click.option("--kind", type=click.Choice(["sensor", "actuator", "param", "action", "service",
                                           "event"]), help="Only resources of this kind.")  # fmt: skip
@click.option("--op", type=click.Choice(["read", "write", "execute", "subscribe"]),
              help="Only resources on which you may use this operation.")  # fmt: skip
@click.option("-q", "--query", "q", metavar="WORDS", help="Words in the path or description.")
@click.option("--profile", metavar="NAME", help="Only resources that this profile defines.")
@click.pass_context
def discover(ctx: click.Context, **arguments: Any) -> int:
    """List resources; for a single path, show the resource with its schemas and examples."""
    return _run(ctx, "discover", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--field", "fields", multiple=True, metavar="NAME",
              help="Only this field (position.x); can be repeated.")  # fmt: skip
@click.option("--frame", metavar="NAME",
              help="The frame of the values: map, base_link, earth.")  # fmt: skip
@click.option(
    "--fresh", is_flag=True, help="Read from the robot, even if a recent value is available."
)
@click.pass_context
def read(ctx: click.Context, **arguments: Any) -> int:
    """Print the current value of each PATH, or of everything that a PATTERN matches."""
    return _run(ctx, "read", **arguments)


@rcpctl.command(context_settings=_WITH_VALUE)
@_common
@click.argument("words", nargs=-1, required=True, metavar="PATH VALUE | PATH=VALUE...")
@click.option("--valid-for", type=float, metavar="SECONDS",
              help="Time after which the gateway stops the robot unless the value is written "
                   "again.")  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Check the request without changing anything.")
@click.option(
    "--key", metavar="TEXT", help="Idempotency key: a repeated request is not executed again."
)
@click.option("--approval", metavar="ID", help="Id of an approval, if the command requires one.")
@click.pass_context
def write(ctx: click.Context, **arguments: Any) -> int:
    """Write VALUE to PATH and print the value now in effect.

    PATH=VALUE, several times, writes several paths of one robot as one: all of them or none.
    """
    return _run(ctx, "write", **arguments)


@rcpctl.command(context_settings=_WITH_VALUE)
@_common
@click.argument("path")
@click.argument("input", required=False)
@click.option("--wait/--no-wait", default=True, help="Wait for the end [--wait].")
@click.option("--deadline", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Time limit; the robot is stopped when it passes [that of the "
                   "path].")  # fmt: skip
@click.option("--feedback/--no-feedback", default=None,
              help="Show feedback while the command runs [on a terminal].")  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Check the request without changing anything.")
@click.option(
    "--key", metavar="TEXT", help="Idempotency key: a repeated request is not executed again."
)
@click.option("--approval", metavar="ID", help="Id of an approval, if the command requires one.")
@click.pass_context
def execute(ctx: click.Context, **arguments: Any) -> int:
    """Run the action or service at PATH.

    The first Ctrl-C cancels the command and waits for its final status; the second stops waiting.
    """
    return _run(ctx, "execute", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("file")
@click.option("--wait/--no-wait", default=True, help="Wait for the end [--wait].")
@click.option("--deadline", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Time limit; the robots are stopped when it passes [an hour].")  # fmt: skip
@click.option("--feedback/--no-feedback", default=None,
              help="Show each step while the plan runs [on a terminal].")  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Check the whole plan without running it.")
@click.option(
    "--key", metavar="TEXT", help="Idempotency key: a repeated request is not executed again."
)
@click.option("--approval", metavar="ID", help="Id of an approval, if the command requires one.")
@click.pass_context
def plan(ctx: click.Context, file: str, **arguments: Any) -> int:
    """Run the plan in FILE (- for standard input); the gateway checks all of it first.

    FILE contains steps in JSON, the output of a PDDL planner, or lines such as `execute
    /action/dock`.
    Ctrl-C works as for `execute`.
    """
    return _run(ctx, "plan", input="-" if file == "-" else f"@{file}", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("patterns", nargs=-1, required=True, metavar="PATTERN...")
@click.option("--rate", type=click.FloatRange(0, min_open=True), metavar="HZ",
              help="Maximum updates per second and path.")  # fmt: skip
@click.option("--count", type=click.IntRange(1), metavar="N", help="Stop after N updates.")
@click.option("--duration", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Stop after this time.")  # fmt: skip
@click.option(
    "--history", metavar="N|SPAN", help="Start with the last N samples, or those of the last 30s."
)
@click.option("--change", is_flag=True, help="Only values that differ from the previous one.")
@click.option("--deadband", metavar="NUMBER|P%|JSON", help="Only changes of at least this size.")
@click.option(
    "--where", metavar="JSON", help='Only samples that match, e.g. {"field":"voltage","lt":11.1}.'
)
@click.option("--field", "fields", multiple=True, metavar="NAME",
              help="Only this field (position.x); can be repeated.")  # fmt: skip
@click.option("--frame", metavar="NAME",
              help="The frame of the values: map, base_link, earth.")  # fmt: skip
@click.option("--reliable", is_flag=True, help="Deliver every sample in order, or fail.")
@click.option("--initial/--no-initial", default=True, help="Start with the current value [yes].")
@click.pass_context
def watch(ctx: click.Context, **arguments: Any) -> int:
    """Print a line for every new value until Ctrl-C; notices go to standard error."""
    return _run(ctx, "watch", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.option("-w", "--watch", is_flag=True, help="Refresh once per second.")
@click.pass_context
def status(ctx: click.Context, **arguments: Any) -> int:
    """Show the health of the gateway and its robots."""
    return _run(ctx, "status", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.option("--running", is_flag=True, help="Only running and queued commands.")
@click.pass_context
def commands(ctx: click.Context, **arguments: Any) -> int:
    """List running and recent commands, newest first."""
    return _run(ctx, "commands", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("command", metavar="ID|PATH")
@click.pass_context
def cancel(ctx: click.Context, **arguments: Any) -> int:
    """Cancel a command by its ID, or whatever runs at PATH."""
    return _run(ctx, "cancel", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("scope", required=False)
@click.option("--scope", "named", metavar="SCOPE", hidden=True)
@click.option("--reset", is_flag=True,
              help="Reset the e-stop. Your role must have `reset = true`.")  # fmt: skip
@click.option("--reason", metavar="TEXT", help="Reason, for the record and for other operators.")
@click.pass_context
def estop(ctx: click.Context, scope: str | None, named: str | None, **arguments: Any) -> int:
    """Stop robots now, and latch the stop until someone resets it.

    SCOPE is a robot (/tenant/alpha/rover, or the name of its backend), a group of the gateway's
    configuration, or a tenant (/tenant/alpha). Default: every robot that you may see.

    For each robot the output shows when the stop was requested, when the robot was commanded to stop,
    and when it was confirmed at rest by measurement. The exit status is 1 if a robot is not confirmed
    within --timeout: it stays latched and the gateway keeps sending the stop, but do not approach
    it.
    """
    if scope is not None and named is not None:
        raise click.UsageError("SCOPE is given twice")
    return _run(ctx, "estop", scope=scope or named, **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("robot", required=False)
@click.pass_context
def hold(ctx: click.Context, **arguments: Any) -> int:
    """Bring ROBOT to rest and end its commands, without an emergency stop.

    There is no latch: the next command moves the robot again. ROBOT is a name from `rcpctl status`
    or from the robot's paths. Default: every robot of your tenant. The exit status
    is 1 if a robot is not at rest; then use `rcpctl estop`.
    """
    return _run(ctx, "hold", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.option("--all", "every", is_flag=True, help="Include decided and expired approvals.")
@click.pass_context
def approvals(ctx: click.Context, **arguments: Any) -> int:
    """List open approvals: those that you may decide on, and your own requests."""
    return _run(ctx, "approvals", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("approval", metavar="ID")
@click.option("--reject", is_flag=True, help="Reject instead of approve.")
@click.option("--reason", metavar="TEXT", help="Reason, for the audit log and the requester.")
@click.pass_context
def approve(ctx: click.Context, **arguments: Any) -> int:
    """Approve a command of someone else, once; see `rcpctl approvals`."""
    return _run(ctx, "approve", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.argument("text", nargs=-1)
@click.pass_context
def robots(ctx: click.Context, **arguments: Any) -> int:
    """List robots, or those that TEXT finds: by name, kind (drone), profile, vendor or model."""
    return _run(ctx, "robots", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.pass_context
def fleet(ctx: click.Context, **arguments: Any) -> int:
    """List the robots of a hub with their gateways and links, those with a problem first.

    GATEWAY and RCP are the versions that the robot's gateway runs and speaks, CLOCK is how far its
    clock is ahead of the hub's, with the bound of the error, and LOST counts the links that ended
    because messages were lost. --json has more, such as why a link ended.
    """
    return _run(ctx, "fleet", **arguments)


@rcpctl.group(context_settings=_CONTEXT)
@_common
def lease() -> None:
    """Take exclusive control of a tenant, a robot, or a sub-tree such as /actuator."""


@lease.command(name="list", context_settings=_CONTEXT)
@_common
@click.pass_context
def lease_list(ctx: click.Context, **arguments: Any) -> int:
    """List leases and their holders."""
    return _run(ctx, "lease list", **arguments)


def _acquiring(function: F) -> F:
    options = (
        click.argument("scope"),
        click.option(
            "--ttl",
            type=click.FloatRange(0, min_open=True),
            metavar="SECONDS",
            help="Time until the lease expires unless renewed [the gateway's default].",
        ),
        click.option(
            "--take", is_flag=True, help="Take the lease over from holders with a lower priority."
        ),
        click.option(
            "--reason",
            metavar="TEXT",
            help="Reason; required with --take, shown to the previous holder.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


@lease.command(name="acquire", context_settings=_CONTEXT)
@_common
@_acquiring
@click.pass_context
def lease_acquire(ctx: click.Context, **arguments: Any) -> int:
    """Acquire SCOPE for all sessions of your principal until it expires or is released."""
    return _run(ctx, "lease acquire", **arguments)


@lease.command(name="release", context_settings=_CONTEXT)
@_common
@click.argument("scope")
@click.pass_context
def lease_release(ctx: click.Context, **arguments: Any) -> int:
    """Release the lease; running commands continue."""
    return _run(ctx, "lease release", **arguments)


@lease.command(name="hold", context_settings=_CONTEXT)
@_common
@_acquiring
@click.pass_context
def lease_hold(ctx: click.Context, **arguments: Any) -> int:
    """Hold the lease on SCOPE until Ctrl-C, or until someone takes it over."""
    return _run(ctx, "lease hold", **arguments)


@rcpctl.group(context_settings=_CONTEXT)
@_common
def mcp() -> None:
    """Look at what the gateway offers to models (MCP)."""


@mcp.command(name="tools", context_settings=_CONTEXT)
@_common
@click.option("--cost", is_flag=True, help="Show about how many tokens each tool costs a model.")
@click.option("--path", default="/mcp", show_default=True, help="Path of the MCP server.")
@click.pass_context
def mcp_tools(ctx: click.Context, **arguments: Any) -> int:
    """List the tools that a model sees with your rights.

    --cost is an estimate, the same for every model: the bytes of a tool's JSON divided by 4.
    """
    return _run(ctx, "mcp tools", **arguments)


@rcpctl.command(context_settings=_CONTEXT)
@_common
@click.option("--lang", required=True, type=click.Choice(["python", "typescript"]),
              help="Output language.")  # fmt: skip
@click.argument("pattern", required=False)
@click.pass_context
def codegen(ctx: click.Context, **arguments: Any) -> int:
    """Generate a typed client module for all resources (or those matching PATTERN)."""
    return _run(ctx, "codegen", **arguments)


def main() -> None:
    """Run `rcpctl` and exit with its status."""
    try:
        code = rcpctl.main(standalone_mode=False, prog_name="rcpctl")
    except click.exceptions.Exit as ended:
        code = ended.exit_code
    except click.ClickException as error:
        error.show()
        code = _USAGE
    except (click.Abort, KeyboardInterrupt):
        code = _INTERRUPTED
    sys.exit(code or 0)
