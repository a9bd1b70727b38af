"""`rcpd init`: a configuration to start from, with keys and a systemd unit."""

from __future__ import annotations

import getpass
import os
import shlex
import shutil
import socket
import sys
from pathlib import Path
from typing import Any

import click

from rcp_gateway.plugins import installed
from rcp_kernel.errors import ConfigError
from rcpd.exits import fail
from rcpd.installed import obstacle
from rcpd.starter import ROBOTS, Answers, is_local, starter_files, write_files

__all__ = ["init"]

_TRIES = {
    "sim": """execute /action/move_to '{"position": {"x": 2, "y": 1}}'""",
    "mujoco": """execute /action/move_to '{"position": {"x": 1, "y": 1}}'""",
    "ros2": "discover",
    "mavlink": "execute /action/arm",
    "can": "discover",
}


@click.command()
@click.option(
    "--into", type=click.Path(path_type=Path), default=Path(), help="Folder [the current one]."
)
@click.option("--robot-kind", "use", type=click.Choice(ROBOTS), help="Backend of the robot [sim].")
@click.option("--name", help="Name of the gateway [this machine's].")
@click.option("--robot", help="Name of the robot [robot].")
@click.option("--tenant", help="Tenant of the robot [main].")
@click.option("--host", help="Address to listen on [127.0.0.1: only this machine].")
@click.option("--port", type=click.IntRange(1, 65535), help="Port to listen on [8080].")
@click.option(
    "--state", type=click.Path(path_type=Path), help="Folder of the store [the same as --into]."
)
@click.option("--user", help="User of the systemd unit [you].")
@click.option("-y", "--yes", is_flag=True, help="Ask nothing; what is not given has its default.")
@click.option("--force", is_flag=True, help="Replace files that are already there, keys too.")
def init(*, into: Path, state: Path | None, yes: bool, force: bool, **given: Any) -> None:
    """Write a configuration with comments, keys and a systemd unit, to start and then edit.

    On a terminal it asks for what is not given. The gateway listens on this machine only, unless
    --host says otherwise: then it has a certificate of its own, and nobody may do anything without
    a key.
    """
    ask = not yes and sys.stdin.isatty()
    folder = into.expanduser().resolve()
    answers = Answers(
        folder=folder,
        state=folder if state is None else state.expanduser().resolve(),
        **_answered(given, ask=ask),
    )
    try:
        found = starter_files(answers)
        write_files(found, replace=force, user=answers.user)
    except ConfigError as error:
        fail(str(error))
    _report(answers, found)


def _answered(given: dict[str, Any], *, ask: bool) -> dict[str, Any]:
    """Complete the answers: by questions, or by defaults."""
    host = socket.gethostname().partition(".")[0][:64] or "gateway"
    questions: dict[str, tuple[str, Any, Any]] = {
        "use": ("Robot", "sim", click.Choice(ROBOTS)),
        "robot": ("Name of the robot", "robot", str),
        "tenant": ("Tenant (who owns it)", "main", str),
        "name": ("Name of this gateway", host, str),
        "host": ("Address to listen on", "127.0.0.1", str),
        "port": ("Port", 8080, click.IntRange(1, 65535)),
    }
    found = {"user": given["user"] or getpass.getuser()}
    for key, (question, default, kind) in questions.items():
        found[key] = given[key]
        if found[key] is None:
            found[key] = click.prompt(question, default, type=kind) if ask else default
    return found


def _reachable(host: str) -> str:
    """Return the address by which this machine reaches a listener."""
    if host in ("0.0.0.0", "::", ""):  # noqa: S104 - of all of its addresses this one is always there
        return "127.0.0.1"
    return f"[{host}]" if ":" in host else host


def _report(answers: Answers, found: dict[Path, bytes]) -> None:
    point = installed("backends").get(answers.use)
    reason = None if point is None else obstacle(point)
    if reason is not None:
        click.echo(f"rcpd: the backend '{answers.use}' cannot be used yet: {reason}", err=True)
    click.echo(f"Wrote {', '.join(_near(path) for path in found)}.")
    config, folder = answers.folder / "rcp.toml", _near(answers.folder)
    serve = "" if _near(config) == "rcp.toml" else f" {shlex.quote(_near(config))}"
    scheme = "http" if is_local(answers.host) else "https"
    at = f"{scheme}://{_reachable(answers.host)}:{answers.port}"
    ca = (
        ""
        if scheme == "http"
        else f" RCP_CACERT={shlex.quote(f'{answers.folder}/tls/gateway.pem')}"
    )
    click.echo(
        f"Start it:\n  rcpd serve{serve}\n"
        "Then, in another terminal:\n"
        f'  export RCP_URL={at}{ca} RCP_TOKEN="$(cat {shlex.quote(f"{folder}/operator.key")})"\n'
        f"  rcpctl {_TRIES[answers.use]}\n"
        f"Dashboard: {at}, with the key of operator.key. admin.key also resets an e-stop."
    )
    if shutil.which("systemctl") and os.name == "posix":
        unit = shlex.quote(f"{folder}/rcp-gateway.service")
        click.echo(
            f"As a service:\n  sudo cp {unit} /etc/systemd/system/ && sudo systemctl enable --now rcp-gateway"
        )


def _near(path: Path) -> str:
    """Return a path as it is said in the current folder."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)
