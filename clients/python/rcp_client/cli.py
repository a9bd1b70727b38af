"""`rcpctl`: the command-line client of a gateway, for terminals and shell scripts."""

from __future__ import annotations

import sys

import click

from rcp_client.subcommands.leases import lease
from rcp_client.subcommands.options import CONTEXT, common
from rcp_client.subcommands.programs import codegen, mcp
from rcp_client.subcommands.recordings import record, replay
from rcp_client.subcommands.resources import discover, read, write
from rcp_client.subcommands.robots import approvals, approve, estop, fleet, hold, robots, status
from rcp_client.subcommands.running import cancel, commands, execute, plan
from rcp_client.subcommands.streams import plot, top, watch
from rcp_client.subcommands.triggers import alarms, triggers

__all__ = ["main"]

_USAGE = 2
_INTERRUPTED = 130


@click.group(context_settings=CONTEXT)
@common
@click.version_option(package_name="rcp-client", message="rcpctl %(version)s")
def rcpctl() -> None:
    """Read, write, command and watch robots through an RCP gateway.

    PATH is the path of a resource; without /tenant/<name> it refers to your own tenant. In a
    PATTERN, * is one segment and ** any number. A VALUE or INPUT is JSON, or plain text if the
    path expects a string; - reads it from standard input, @FILE from a file.

    Exit status: 0 completed, 1 failed (or a robot is not at rest), 2 usage, 3 rejected or denied,
    4 gateway unreachable (1 if what was sent may have been executed), 130 interrupted.
    """


@rcpctl.command(context_settings=CONTEXT)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion of a shell, which asks the gateway for paths.

    bash: eval "$(rcpctl completion bash)" in ~/.bashrc; zsh: the same with zsh in ~/.zshrc; fish:
    rcpctl completion fish > ~/.config/fish/completions/rcpctl.fish
    """
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(rcpctl, {}, "rcpctl", "_RCPCTL_COMPLETE").source())


for _command in (
    discover,
    read,
    write,
    execute,
    plan,
    commands,
    cancel,
    watch,
    plot,
    top,
    status,
    robots,
    fleet,
    estop,
    hold,
    approvals,
    approve,
    lease,
    triggers,
    alarms,
    record,
    replay,
    mcp,
    codegen,
):
    rcpctl.add_command(_command)


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
