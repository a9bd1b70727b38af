"""Subcommands on triggers and alarms."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, common, run

__all__ = ["alarms", "triggers"]


@click.group(context_settings=CONTEXT, invoke_without_command=True)
@common
@click.pass_context
def triggers(ctx: click.Context) -> int:
    """List, add, remove and test triggers: conditions on robots that notify or act.

    Without a subcommand it lists them. CONDITION is unknown while a value is missing or stale, which
    neither fires nor clears.
    """
    return 0 if ctx.invoked_subcommand else run(ctx, "triggers list")


@triggers.command(name="list", context_settings=CONTEXT)
@common
@click.pass_context
def triggers_list(ctx: click.Context) -> int:
    """List triggers with their state on each robot."""
    return run(ctx, "triggers list")


@triggers.command(name="add", context_settings=CONTEXT)
@common
@click.argument("trigger", metavar="NAME")
@click.option("--robot", required=True, metavar="PATH",
              help="/tenant/alpha/rover, or /tenant/alpha/* for each robot.")  # fmt: skip
@click.option("--when", required=True, metavar="CEL",
              help='Condition, e.g. "sensor.battery.percentage < 0.2".')  # fmt: skip
@click.option("--clear", metavar="CEL", help="Condition that clears it [--when is false].")
@click.option("--for", "held", type=click.FloatRange(0), metavar="SECONDS",
              help="How long the condition must hold.")  # fmt: skip
@click.option("--on", type=click.Choice(["level", "edge"]),
              help="Fire if the condition holds, or only when it becomes true [level].")  # fmt: skip
@click.option("--repeat", type=click.FloatRange(1), metavar="SECONDS",
              help="Fire again in this interval while it holds.")  # fmt: skip
@click.option("--cool-down", type=click.FloatRange(0), metavar="SECONDS",
              help="Least time between two firings.")  # fmt: skip
@click.option("--message", metavar="TEXT", help="What it says to people [the condition].")
@click.option("--severity", type=click.Choice(["info", "warning", "critical"]),
              help="How bad it is [warning].")  # fmt: skip
@click.option("--notify", multiple=True, metavar="TARGET",
              help="A target of the gateway's configuration; can be repeated.")  # fmt: skip
@click.option("--notify-cleared", is_flag=True, help="Tell the targets when it clears, too.")
@click.option("--alarm", is_flag=True, help="Raise an alarm that must be acknowledged.")
@click.option("--incident", is_flag=True, help="Have the recorder's black box written.")
@click.option("--execute", metavar="PATH", help="Run an action, a service, or /system/plans.")
@click.option("--value", metavar="INPUT", help="Input of --execute.")
@click.option("--dry-run", is_flag=True, help="Check the trigger without adding it.")
@click.pass_context
def triggers_add(ctx: click.Context, **arguments: Any) -> int:
    """Add the trigger NAME. Its command runs with the rights that you have when it fires."""
    return run(ctx, "triggers add", **arguments)


@triggers.command(name="remove", context_settings=CONTEXT)
@common
@click.argument("trigger", metavar="NAME")
@click.pass_context
def triggers_remove(ctx: click.Context, **arguments: Any) -> int:
    """Remove the trigger NAME."""
    return run(ctx, "triggers remove", **arguments)


@triggers.command(name="test", context_settings=CONTEXT)
@common
@click.argument("trigger", metavar="NAME")
@click.pass_context
def triggers_test(ctx: click.Context, **arguments: Any) -> int:
    """Show what the trigger NAME would do now; nothing is sent, and its command is a dry run."""
    return run(ctx, "triggers test", **arguments)


@click.group(context_settings=CONTEXT, invoke_without_command=True)
@common
@click.pass_context
def alarms(ctx: click.Context) -> int:
    """List and acknowledge alarms. Without a subcommand it lists those that are open."""
    return 0 if ctx.invoked_subcommand else run(ctx, "alarms list", every=False)


@alarms.command(name="list", context_settings=CONTEXT)
@common
@click.option("--all", "every", is_flag=True, help="Include closed alarms.")
@click.pass_context
def alarms_list(ctx: click.Context, **arguments: Any) -> int:
    """List alarms, newest first."""
    return run(ctx, "alarms list", **arguments)


@alarms.command(name="ack", context_settings=CONTEXT)
@common
@click.argument("alarms", nargs=-1, required=True, metavar="ID...")
@click.option("--comment", metavar="TEXT", help="For the record and for others.")
@click.pass_context
def alarms_ack(ctx: click.Context, **arguments: Any) -> int:
    """Acknowledge alarms."""
    return run(ctx, "alarms ack", **arguments)
