"""`rcpd profiles`: list, show, export and publish profiles."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import click

from rcp_kernel.errors import StartupError
from rcp_profiles import Profile, document, profile_named
from rcp_profiles.pages import page
from rcpd.exits import fail

__all__ = ["profiles", "write_profiles"]


@click.command()
@click.argument("name", required=False)
@click.option("--schema", is_flag=True, help="Print JSON Schema; without NAME, of all profiles.")
@click.option(
    "--write",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write pages and schemas into a folder, as docs/profiles has them.",
)
def profiles(name: str | None, *, schema: bool, write: Path | None) -> None:
    """List the profiles that robots can claim, or show the one called NAME."""
    from rcpd.installed import published_profiles

    try:
        known = published_profiles()
        chosen = list(known.values()) if name is None else [profile_named(name, known)]
    except StartupError as error:
        fail(str(error))
    if write is not None:
        write_profiles(chosen, write)
    elif schema:
        documents = [document(one) for one in chosen]
        click.echo(json.dumps(documents if name is None else documents[0], indent=2))
    elif name is None:
        for one in chosen:
            click.echo(f"{one.id:<14} {one.description}")
    else:
        click.echo(page(chosen[0]), nl=False)


def write_profiles(profiles: Iterable[Profile], folder: Path) -> None:
    """Write a page and the schema of each profile below a folder; schemas of older versions stay."""
    (folder / "schemas").mkdir(parents=True, exist_ok=True)
    for one in profiles:
        (folder / f"{one.name}.md").write_text(page(one), encoding="utf-8")
        text = json.dumps(document(one), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
        (folder / "schemas" / f"{one.name}-{one.version}.json").write_text(text, encoding="utf-8")
