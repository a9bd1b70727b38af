"""`rcpd store`: check, back up, repair and restore a gateway's store."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rcp_kernel.errors import ConfigError
from rcp_store.chain import written
from rcpd.examination import examined
from rcpd.exits import FAILED, fail
from rcpd.options import config_argument, path_of, store_option

if TYPE_CHECKING:
    from rcpd.repair import Repaired

__all__ = ["store"]


@click.group()
def store() -> None:
    """Check, back up, repair or restore the store of a gateway."""


@store.command()
@config_argument
@store_option
def check(config: Path, store: Path | None) -> None:
    """Check every page and record, also while the gateway runs; exit code 1 if damaged."""
    from rcp_store.damage import find_damage
    from rcp_store.file import store_errors
    from rcpd.backup import check_whole

    path = store or path_of(config)
    try:
        with store_errors(path):
            damage = find_damage(path, bound=None)
        if damage is not None:
            fail(f"the store '{path}' is damaged: {damage}; run `rcpd store repair`")
        verdict = check_whole(path)
    except ConfigError as error:
        fail(str(error))
    for seq, what in verdict.findings:
        click.echo(f"record {seq}: {what}")
    click.echo(f"{path}: ok; {verdict.count} records; head {written(verdict.head)}")
    if verdict.findings:
        sys.exit(FAILED)


@store.command()
@click.argument("file", type=click.Path(path_type=Path))
@config_argument
@store_option
def backup(file: Path, config: Path, store: Path | None) -> None:
    """Copy the store to FILE, also while the gateway runs, and print the head of its audit log."""
    from rcpd.backup import make_backup

    try:
        verdict = make_backup(store or path_of(config), file)
    except ConfigError as error:
        fail(str(error))
    click.echo(f"{file}: {verdict.count} records; head {written(verdict.head)}")


@store.command()
@config_argument
@store_option
def repair(config: Path, store: Path | None) -> None:
    """Rebuild a damaged store from what is readable; the gateway must be stopped.

    The old files are kept in a folder beside it. Missing records stay missing, and the chain
    records their number. The next start latches every robot until someone resets the e-stop.
    """
    from rcpd.repair import repair

    path = store or path_of(config)
    try:
        made = repair(path)
    except ConfigError as error:
        fail(str(error))
    if made is None:
        click.echo(f"{path}: not damaged, nothing to repair")
    else:
        _tell(path, made)


@store.command()
@click.argument("backup", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@config_argument
@store_option
def restore(backup: Path, config: Path, store: Path | None) -> None:
    """Replace the store by BACKUP; the gateway must be stopped.

    Later records are added as far as they are readable. The old files are kept in a folder beside
    it. The next start latches every robot until someone resets the e-stop.
    """
    from rcpd.repair import restore

    path = store or path_of(config)
    try:
        made = restore(path, backup)
    except ConfigError as error:
        fail(str(error))
    _tell(path, made)


def _tell(path: Path, made: Repaired) -> None:
    for seq, what in examined(path).findings:
        click.echo(f"record {seq}: {what}")
    click.echo(f"{path}: {made.records} records, {made.missing} missing; head {written(made.head)}")
    click.echo(f"The old files are in {made.aside}.", err=True)
    if made.apart:
        click.echo(
            "Audit records written since the damage stay there: their numbers are already in use.",
            err=True,
        )
    if made.tokens:
        click.echo(
            f"{made.tokens} API keys are valid. Some may have been revoked after the backup: "
            "check `rcpd token list`.",
            err=True,
        )
    click.echo(
        "At the next start every robot is latched: check the robots, then reset the e-stop.",
        err=True,
    )
