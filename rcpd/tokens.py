"""`rcpd token`: create and revoke API keys, also while the gateway runs."""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rcp_kernel.errors import ConfigError
from rcp_protocol.similarity import closest
from rcpd.exits import fail

if TYPE_CHECKING:
    from rcp_kernel.config.file import GatewayConfig
    from rcp_kernel.contract.identity import Grants
    from rcp_store.tokens import Token, TokenFile

__all__ = ["token"]

_UNITS = {"m": 60, "h": 3600, "d": 86_400, "w": 604_800}  # s
_S = 1_000_000_000  # ns
_GLANCE = 0.2  # s spent checking the store for damage
_NAME = r"[A-Za-z0-9_.@-]{1,64}"


@click.group()
def token() -> None:
    """Create, list and revoke API keys. A running gateway applies changes within two seconds."""


def _where(command: Any) -> Any:
    found = click.option(
        "--config",
        type=click.Path(path_type=Path),
        help="Configuration of the gateway, for roles, tenants and [store] path. Default: "
        "./rcp.toml.",
    )(command)
    return click.option(
        "--store",
        type=click.Path(path_type=Path),
        help="The store file, instead of a configuration; roles and tenants are not checked.",
    )(found)


@token.command()
@click.argument("name")
@_where
@click.option("--role", "roles", multiple=True, help="Role; can be repeated.")
@click.option(
    "--tenant", "tenants", multiple=True, help="Tenant; can be repeated. Default: every tenant."
)
@click.option(
    "--grant",
    "grants",
    multiple=True,
    help="TENANT=ROLE, instead of --role and --tenant; can be repeated.",
)
@click.option("--expires", help="30d, 12h, 2027-01-31 or an ISO 8601 time. Default: never.")
def create(
    name: str,
    *,
    config: Path | None,
    store: Path | None,
    roles: tuple[str, ...],
    tenants: tuple[str, ...],
    grants: tuple[str, ...],
    expires: str | None,
) -> None:
    """Create a key for NAME and print it once; only its hash is stored."""
    from rcp_kernel.config.identity import check_grants
    from rcp_kernel.config.role import BUILTIN_ROLES

    if not re.fullmatch(_NAME, name):
        fail("NAME must be 1 to 64 characters: letters, digits and . _ @ -")
    given = _granted(roles, tenants, grants)
    try:
        end = None if expires is None else _end(expires)
        path, read = _found(config, store)
        if read is not None:
            check_grants(given, "the token", read.tenant_names, {**BUILTIN_ROLES, **read.roles})
        with _opened(path) as table:
            made, key = table.create(name, given, end)
    except (ConfigError, ValueError) as error:
        fail(str(error))
    click.echo(f"{_line(made)}\nThe key (shown only once):", err=True)
    click.echo(key)


@token.command("list")
@_where
@click.option("--all", "every", is_flag=True, help="Include expired and revoked keys.")
def list_(*, config: Path | None, store: Path | None, every: bool) -> None:
    """List the keys, without their secrets."""
    from rcp_kernel.clock import now

    moment = now()
    for one in _read(config, store):
        if every or one.state(moment) == "good":
            click.echo(_line(one))


@token.command()
@click.argument("named", metavar="NAME|ID")
@_where
def revoke(named: str, *, config: Path | None, store: Path | None) -> None:
    """Revoke a key by its ID, or all keys of a NAME, and close their sessions."""
    try:
        path, _ = _found(config, store)
        with _opened(path) as table:
            gone = table.revoke(named)
            left = [t for t in table.every() if t.revoked is None]
    except ConfigError as error:
        fail(str(error))
    if not gone:
        near = closest(named, [word for one in left for word in (one.name, one.id)])
        advice = f"; did you mean '{near}'?" if near else "; `rcpd token list` lists the keys"
        fail(f"no valid key is named '{named[:64]}'{advice}")
    for one in gone:
        click.echo(f"revoked {one.id} {one.name}")


@contextmanager
def _opened(path: Path) -> Generator[TokenFile]:
    """Open the keys that the gateway uses: beside a damaged store, if it continues there.

    :raises ConfigError: they cannot be read or written.
    """
    from rcp_store.damage import find_damage, interim_of
    from rcp_store.file import store_errors
    from rcp_store.tokens import TokenFile

    with store_errors(path):
        damage = find_damage(path, bound=_GLANCE)
        if damage is not None:
            path = interim_of(path)
            if not path.exists():
                raise ConfigError(f"the store is damaged: {damage}. Run `rcpd store repair` first")
        with closing(TokenFile(path)) as table:
            if table.warning is not None:
                click.echo(f"rcpd: {table.warning}", err=True)
            yield table


def _read(config: Path | None, store: Path | None) -> list[Token]:
    try:
        path, _ = _found(config, store)
        with _opened(path) as table:
            return table.every()
    except ConfigError as error:
        fail(str(error))


def _found(config: Path | None, store: Path | None) -> tuple[Path, GatewayConfig | None]:
    """Return the store, and the configuration that names it, if any."""
    from rcp_kernel.access.identities import store_file
    from rcp_kernel.config.file import load

    if store is not None:
        if config is not None:
            raise ConfigError("give either --config or --store")
        if not store.expanduser().exists():
            raise ConfigError(f"the store '{store}' does not exist; use --config to create it")
        return store.expanduser(), None
    source = config or Path("rcp.toml")
    read = load(source)
    path = store_file(read)
    if path is None:
        raise ConfigError(
            f"{source} has no store, and tokens need one: add [store] with a `path`, "
            "then restart the gateway"
        )
    return path, read


def _granted(roles: tuple[str, ...], tenants: tuple[str, ...], grants: tuple[str, ...]) -> Grants:
    from rcp_kernel.contract.identity import granted

    if bool(roles) == bool(grants) or (tenants and grants):
        fail("give --role (and --tenant), or --grant TENANT=ROLE")
    if roles:
        return granted(tenants or ("*",), roles)
    found: dict[str, list[str]] = {}
    for grant in grants:
        tenant, _, role = grant.partition("=")
        if not tenant or not role:
            fail(f"--grant {grant[:64]}: write TENANT=ROLE")
        found.setdefault(tenant, []).append(role)
    return tuple((tenant, tuple(held)) for tenant, held in found.items())


def _end(text: str) -> int:
    from rcp_kernel.clock import now
    from rcp_kernel.config.identity import instant

    span = re.fullmatch(r"(\d{1,6})([mhdw])", text)
    end = now() + int(span[1]) * _UNITS[span[2]] * _S if span else instant(text)
    if end <= now():
        raise ValueError(f"--expires {text[:40]} is in the past")
    return end


def _line(one: Token) -> str:
    from rcp_kernel.clock import iso, now

    grants = " ".join(f"{tenant}={','.join(roles)}" for tenant, roles in one.grants)
    end = "never" if one.expires is None else iso(one.expires)[:19] + "Z"
    return (
        f"{one.id}  {one.name:<20} {one.state(now()):<8} {grants:<30} "
        f"created {iso(one.created)[:19]}Z  expires {end}"
    )
