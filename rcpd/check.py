"""`rcpd check`: every fault of a configuration file, and what it would serve."""

from __future__ import annotations

import sqlite3
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import msgspec

from rcp_kernel.config.file import GatewayConfig
from rcp_store.damage import find_damage
from rcpd.exits import FAILED
from rcpd.reading import text_of
from rcpd.survey import Finding

__all__ = ["check"]


@click.command()
@click.argument("config", type=click.Path(path_type=Path), default="rcp.toml")
@click.option("--json", "as_json", is_flag=True, help="Print faults and warnings as JSON.")
def check(config: Path, *, as_json: bool) -> None:
    """Report every fault of a configuration file, each with its line and what to write instead.

    Opens no robot and no socket. Exit code: 0, or 1 if there is a fault. A library that a configured
    part cannot work without is a fault, although the gateway would serve the other parts; one without
    which a part does less is a warning.
    """
    from rcpd.diagnosis import Diagnosis

    text = text_of(config)
    if isinstance(text, Finding):
        findings, warnings, prepared, full = [text], list[str](), None, False
    else:
        found = Diagnosis(text, str(config))
        prepared = found.prepared()
        warnings = [one.text(str(config)) for one in found.warnings]
        findings, full = found.findings, found.full
    if prepared is not None:
        warnings += _warnings(prepared.config, config)
    if as_json:
        faults = [msgspec.to_builtins(one) for one in findings]
        answer = {"file": str(config), "ok": not faults, "faults": faults, "warnings": warnings}
        click.echo(msgspec.json.format(msgspec.json.encode(answer)))
        sys.exit(FAILED if faults else 0)
    for warning in warnings:
        click.echo(f"warning: {warning}", err=True)
    if prepared is not None:
        _summarise(prepared.config, config)
        return
    count = f"{len(findings)}{' or more' if full else ''}"
    noun = "fault" if count == "1" else "faults"
    click.echo(f"rcpd: {config}: {count} {noun}", err=True)
    for one in findings:
        click.echo(one.text(str(config)), err=True)
    sys.exit(FAILED)


def _warnings(found: GatewayConfig, config: Path) -> list[str]:
    from rcp_kernel.access.identities import store_file
    from rcpd.key_strength import weak_keys

    return [
        *_damage(store_file(found)),
        *(
            f"key '{name}' is easy to guess: use the output of `openssl rand -hex 32` "
            f"instead, or a token: `rcpd token create {name} --config {config} --role ROLE`"
            for name in weak_keys(found.keys)
        ),
    ]


def _damage(path: Path | None) -> list[str]:
    """Tell of a damaged store: the gateway starts with one, but latches its robots."""
    if path is None:
        return []
    damage: Any = None
    with suppress(sqlite3.Error, OSError):  # `serve` reports what is wrong
        damage = find_damage(path)
    if damage is None:
        return []
    text = (
        f"the store is damaged: {damage}; every robot will be latched at the start. "
        "Run `rcpd store repair`"
    )
    return [text]


def _summarise(found: GatewayConfig, config: Path) -> None:
    robots = ", ".join(f"{b.name} ({b.use}, tenant {b.tenant})" for b in found.backends) or "none"
    click.echo(f"{config}: good")
    click.echo(f"  backends      {robots}")
    click.echo(f"  transports    {', '.join(found.transports) or 'none'}")
    click.echo(f"  plugins       {', '.join(found.plugins) or 'none'}")
    click.echo(f"  keys          {', '.join(key.name for key in found.keys) or 'none'}")
    named = dict.fromkeys(one.name for one in found.certificates)
    click.echo(f"  certificates  {', '.join(named) or 'none'}")
    click.echo(f"  issuers       {', '.join(one['issuer'] for one in found.jwt) or 'none'}")
    strangers = sorted({role for _, roles in found.anonymous.grants for role in roles})
    click.echo(f"  anonymous     {', '.join(strangers) or 'refused'}")
