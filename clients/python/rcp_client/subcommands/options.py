"""Options that subcommands share, and how a subcommand runs.

Only command line parsing is imported here; the client is imported when a command runs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import click

__all__ = ["CONTEXT", "WITH_VALUE", "F", "common", "complete", "connected", "run", "watched"]

F = TypeVar("F", bound=Callable[..., Any])

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
# `write PATH -0.5` is a value, not an option.
WITH_VALUE = {**CONTEXT, "ignore_unknown_options": True}


def _keep(ctx: click.Context, param: click.Parameter, value: Any) -> None:
    """Store an option shared by all commands; the last one on the command line wins."""
    if value is not None and param.name is not None:
        ctx.ensure_object(dict)[param.name] = value


def _shared(*names: str, **facts: Any) -> Callable[[F], F]:
    return click.option(*names, expose_value=False, callback=_keep, **facts)


def common(function: F) -> F:
    """Add the options that may precede or follow the subcommand."""
    return _formatted(connected(function))


def connected(function: F) -> F:
    """Add those of a command whose -o names a file."""
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
    )
    for option in reversed(options):
        function = option(function)
    return function


def _formatted(function: F) -> F:
    """Add those of the output's format."""
    options = (
        _shared(
            "-o",
            "--output",
            "shown_as",
            metavar="FORMAT",
            help="table, json, yaml or jsonpath=EXPR [table on a terminal, else JSON lines].",
        ),
        _shared("--json", "shown_as", flag_value="json", help="The same as -o json."),
        _shared("--text", "shown_as", flag_value="table", help="The same as -o table."),
    )
    for option in reversed(options):
        function = option(function)
    return function


watched = click.option("-w", "--watch", is_flag=True, help="Refresh once per second.")


def complete(what: str) -> Callable[[click.Context, click.Parameter, str], Any]:
    """Complete an argument with what the gateway has."""

    def found(ctx: click.Context, _: click.Parameter, incomplete: str) -> Any:
        from rcp_client.console.completion import candidates

        return candidates(ctx, incomplete, what)

    return found


def run(ctx: click.Context, command: str, /, **arguments: Any) -> int:
    """Run what a subcommand does, and return the exit status."""
    from rcp_client.console.run import run as run_connected

    try:
        return run_connected(command, ctx.ensure_object(dict), arguments)
    except BrokenPipeError:  # the reader has closed the pipe, as in `rcpctl watch … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
