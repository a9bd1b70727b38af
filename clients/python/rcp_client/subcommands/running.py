"""Subcommands that start commands and plans, list and cancel them."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, WITH_VALUE, common, complete, run, watched

__all__ = ["cancel", "commands", "execute", "plan"]


@click.command(context_settings=WITH_VALUE)
@common
@click.argument("path", shell_complete=complete("execute"))
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
    return run(ctx, "execute", **arguments)


@click.command(context_settings=CONTEXT)
@common
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
    return run(ctx, "plan", input="-" if file == "-" else f"@{file}", **arguments)


@click.command(context_settings=CONTEXT)
@common
@watched
@click.option("--running", is_flag=True, help="Only running and queued commands.")
@click.pass_context
def commands(ctx: click.Context, **arguments: Any) -> int:
    """List running and recent commands, newest first."""
    return run(ctx, "commands", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("command", metavar="ID|PATH", shell_complete=complete("commands"))
@click.pass_context
def cancel(ctx: click.Context, **arguments: Any) -> int:
    """Cancel a command by its ID, or whatever runs at PATH."""
    return run(ctx, "cancel", **arguments)
