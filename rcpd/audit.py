"""`rcpd audit`: verify or export the audit log."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import click

from rcp_kernel.clock import parse_time
from rcp_kernel.errors import BadRequest, ConfigError
from rcp_store.chain import Head, decoded, parse_head, written
from rcp_store.file import FAULTS, open_read_only
from rcpd.examination import examined, rows_of
from rcpd.exits import FAILED, fail
from rcpd.options import config_argument, path_of, store_option

__all__ = ["audit"]


def _head(text: str) -> Head:
    try:
        return parse_head(text)
    except ValueError:
        raise click.BadParameter("a head is SEQ:HASH, as `rcpd audit verify` prints it") from None


def _moment(text: str) -> int:
    try:
        return parse_time(text + "T00:00:00Z" if len(text) == 10 else text)
    except BadRequest as error:
        raise click.BadParameter(error.message) from None


@click.group()
def audit() -> None:
    """Verify or export the audit log of a gateway, also while it runs."""


@audit.command("verify")
@config_argument
@store_option
@click.option(
    "--head",
    "heads",
    type=_head,
    multiple=True,
    metavar="SEQ:HASH",
    help="A head stored elsewhere, which the chain must contain.",
)
def verify_command(config: Path, store: Path | None, heads: tuple[Head, ...]) -> None:
    """Report changed, removed, inserted or reordered records, and print the head.

    The exit code is 1 if there are any. Records missing at the end are found if a later head is
    known: from the file beside the database, or from --head.
    """
    path = store or path_of(config)
    try:
        verdict = examined(path, heads)
    except ConfigError as error:
        fail(str(error))
    for seq, what in verdict.findings:
        click.echo(f"record {seq}: {what}")
    last = verdict.head[0]
    click.echo(f"{verdict.count} records, {verdict.first} to {last}; head {written(verdict.head)}")
    if verdict.findings:
        sys.exit(FAILED)


@audit.command()
@config_argument
@store_option
@click.option(
    "--since",
    type=_moment,
    metavar="TIME",
    help="Only records from this time on (ISO 8601 in UTC, or a date).",
)
@click.option(
    "--until",
    type=_moment,
    metavar="TIME",
    help="Only records before this time (ISO 8601 in UTC, or a date).",
)
@click.option("--tenant", help="Only records of this tenant.")
@click.option(
    "--what",
    multiple=True,
    help="Only records of this type (write, command, denial, …); can be repeated.",
)
def export(
    config: Path,
    store: Path | None,
    since: int | None,
    until: int | None,
    tenant: str | None,
    what: tuple[str, ...],
) -> None:
    """Print audit records as JSON lines."""
    path = store or path_of(config)
    try:
        base = open_read_only(path)
    except ConfigError as error:
        fail(str(error))
    with closing(base):
        try:
            for seq, _, data in rows_of(base):
                record = decoded(data)
                if not record:
                    click.echo(f"rcpd: record {seq} cannot be read: verify", err=True)
                elif _wanted(record, since, until, tenant, what):
                    click.echo(data)
        except FAULTS as error:
            fail(f"the store '{path}' cannot be read any further: {error}")


def _wanted(
    record: dict[str, Any],
    since: int | None,
    until: int | None,
    tenant: str | None,
    what: tuple[str, ...],
) -> bool:
    if tenant is not None and record.get("tenant") != tenant:
        return False
    if what and record.get("what") not in what:
        return False
    if since is None and until is None:
        return True
    try:
        moment = parse_time(str(record.get("time")))
    except BadRequest:
        return True
    return (since is None or moment >= since) and (until is None or moment < until)
