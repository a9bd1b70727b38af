"""Subcommands on robots as a whole: their state, stops, and approvals of what they are to do."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, common, complete, run, watched

__all__ = ["approvals", "approve", "estop", "fleet", "hold", "robots", "status"]


@click.command(context_settings=CONTEXT)
@common
@watched
@click.pass_context
def status(ctx: click.Context, **arguments: Any) -> int:
    """Show the health of the gateway and its robots."""
    return run(ctx, "status", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("text", nargs=-1)
@watched
@click.pass_context
def robots(ctx: click.Context, **arguments: Any) -> int:
    """List robots, or those that TEXT finds: by name, kind (drone), profile, vendor or model."""
    return run(ctx, "robots", **arguments)


@click.command(context_settings=CONTEXT)
@common
@watched
@click.pass_context
def fleet(ctx: click.Context, **arguments: Any) -> int:
    """List the robots of a hub with their gateways and links, those with a problem first.

    GATEWAY and RCP are the versions that the robot's gateway runs and speaks, CLOCK is how far its
    clock is ahead of the hub's, with the bound of the error, and LOST counts the links that ended
    because messages were lost. --json has more, such as why a link ended.
    """
    return run(ctx, "fleet", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("scope", required=False, shell_complete=complete("robots"))
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
    return run(ctx, "estop", scope=scope or named, **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("robot", required=False, shell_complete=complete("robots"))
@click.pass_context
def hold(ctx: click.Context, **arguments: Any) -> int:
    """Bring ROBOT to rest and end its commands, without an emergency stop.

    There is no latch: the next command moves the robot again. ROBOT is a name from `rcpctl status`
    or from the robot's paths. Default: every robot of your tenant. The exit status
    is 1 if a robot is not at rest; then use `rcpctl estop`.
    """
    return run(ctx, "hold", **arguments)


@click.command(context_settings=CONTEXT)
@common
@watched
@click.option("--all", "every", is_flag=True, help="Include decided and expired approvals.")
@click.pass_context
def approvals(ctx: click.Context, **arguments: Any) -> int:
    """List open approvals: those that you may decide on, and your own requests."""
    return run(ctx, "approvals", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("approval", metavar="ID", shell_complete=complete("approvals"))
@click.option("--reject", is_flag=True, help="Reject instead of approve.")
@click.option("--reason", metavar="TEXT", help="Reason, for the audit log and the requester.")
@click.pass_context
def approve(ctx: click.Context, **arguments: Any) -> int:
    """Approve a command of someone else, once; see `rcpctl approvals`."""
    return run(ctx, "approve", **arguments)
