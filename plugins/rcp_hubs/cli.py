"""`rcpd fleet`: keys of hubs and of the fleet, revocation, invitations, roll-out; `rcpd enroll`."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rcp_kernel.errors import ConfigError, StartupError, Unauthenticated

if TYPE_CHECKING:
    from rcp_hubs.enrolment import CertificateSigner
    from rcp_kernel.config.file import BackendConfig

__all__ = ["enroll", "fleet"]


class _Command(click.Command):
    """A command that names the extra if a library is missing."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run it."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            text = f"{error.name} is not installed: pip install 'rcp-gateway[fleet]'"
            raise click.ClickException(text) from error


@click.group()
def fleet() -> None:
    """Make keys of hubs and of the fleet, revoke those of hubs, invite and configure robots."""


@fleet.command(cls=_Command)
@click.argument("file", type=click.Path(path_type=Path))
def key(file: Path) -> None:
    """Make an Ed25519 key: FILE, which only you can read, and FILE.pub."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
        PublicFormat,
    )

    made = Ed25519PrivateKey.generate()
    secret = made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    public = made.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    try:
        with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
            out.write(secret)
        file.with_name(f"{file.name}.pub").write_bytes(public)
    except OSError as error:
        raise click.ClickException(f"'{file}' cannot be written: {error.strerror}") from None
    click.echo(f"{file} (secret) and {file}.pub")


@fleet.command(cls=_Command)
@click.option("--key", "secret", required=True, help="Private key of the fleet.")
@click.option(
    "--list",
    "file",
    required=True,
    type=click.Path(path_type=Path),
    help="The list, which hubs publish: `revoked` of their backend. Made if it is not there.",
)
@click.argument("hubs", metavar="PUBLIC_KEY...", nargs=-1, required=True)
def revoke(secret: str, file: Path, hubs: tuple[str, ...]) -> None:
    """Add the public keys of hubs to the list of revoked ones, and sign it."""
    from rcp_hubs.revocation import NONE, RevocationList, fleet_key, read_list, sign_list
    from rcp_hubs.signer import public_pem, read_private_key
    from rcp_jwt.jwks import read_static

    try:
        private = read_private_key(secret, "--key")
        gone = [one.thumbprint for one in read_static(hubs, "revoke", "PUBLIC_KEY")]
        old = NONE
        if file.exists():
            old = read_list(file.read_bytes().strip(), fleet_key(public_pem(private)))
        keys = tuple(dict.fromkeys((*old.keys, *gone)))
        found = RevocationList(number=old.number + 1, keys=keys)
        fresh = file.with_name(f"{file.name}.new")
        fresh.write_text(sign_list(found, private), encoding="ascii")
        fresh.replace(file)
    except (ConfigError, Unauthenticated) as error:
        raise click.ClickException(str(error)) from None
    except OSError as error:
        raise click.ClickException(f"'{file}': {error.strerror}") from None
    click.echo(f"{file}: number {found.number}, {len(keys)} revoked")


@fleet.command(cls=_Command)
@click.argument("gateway")
@click.option("--config", type=click.Path(path_type=Path), default="rcp.toml", help="Of the hub.")
@click.option("--connect", "routers", multiple=True, required=True, help="Router: tls/HOST:PORT.")
@click.option("--ca", required=True, help="Certificate of the fleet's CA.")
@click.option("--ca-key", required=True, help="Its private key.")
@click.option("--role", "roles", multiple=True, required=True, help="That the hub may assert.")
@click.option("--fleet-key", help="Public key that signs the list of revoked hubs.")
@click.option("--port", default=7448, show_default=True, help="On which to wait for the robot.")
@click.option("--minutes", default=15.0, show_default=True, help="Until the code expires.")
@click.option("--days", default=365.0, show_default=True, help="Until the certificate expires.")
def invite(
    gateway: str,
    *,
    config: Path,
    routers: tuple[str, ...],
    ca: str,
    ca_key: str,
    roles: tuple[str, ...],
    fleet_key: str | None,
    port: int,
    minutes: float,
    days: float,
) -> None:
    """Print a one-time code for a robot's GATEWAY, and wait until `rcpd enroll` has used it."""
    from rcp_hubs.enrolment import EnrolmentError, Identity, Invitation
    from rcp_kernel.config.file import load

    try:
        backend = _fleet_of(load(config).backends, config)
        public = None if fleet_key is None else Path(fleet_key).read_text(encoding="ascii")
        tables = _tables(gateway, backend, routers, roles, has_fleet_key=public is not None)
        identity = Identity(
            configuration=tables, ca=Path(ca).read_text(encoding="ascii"), fleet_key=public
        )
        invitation = Invitation(gateway, identity, _authority(ca, ca_key), days=days, port=port)
    except (ConfigError, OSError, ValueError) as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"On the robot, within {minutes:g} min: rcpd enroll THIS_HOST:{invitation.port}")
    click.echo(f"Code: {invitation.code}")
    try:
        invitation.serve(minutes * 60)
    except EnrolmentError as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"{gateway} is enrolled. Add it to `robots` of the backend '{backend.name}'.")


@fleet.command("roll-out", cls=_Command)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--robot", "robots", multiple=True, required=True, help="Gateway; may be repeated.")
@click.option("--seconds", default=60.0, show_default=True, help="Until a robot rolls back.")
@click.option("--restart", is_flag=True, help="Restart gateways whose reload is not enough.")
@click.option("--url", help="Of the hub [RCP_URL; http://127.0.0.1:8080].")
@click.option("--token", help="API key or JWT [RCP_TOKEN].")
@click.option("--tenant", help="Of the robots [RCP_TENANT].")
def roll_out(
    file: Path,
    *,
    robots: tuple[str, ...],
    seconds: float,
    restart: bool,
    url: str | None,
    token: str | None,
    tenant: str | None,
) -> None:
    """Give robots the configuration FILE over a hub, one after the other, until one fails.

    A robot checks it, and rolls back by itself unless this command confirms it.
    """
    import asyncio

    from rcp_client import connect
    from rcp_hubs.roll_out import RollOut, RollOutError
    from rcp_kernel.errors import RcpError

    async def run(data: bytes) -> None:
        async with connect(url, token=token, tenant=tenant) as client:
            made = RollOut(client, data, seconds=seconds, restart=restart, say=click.echo)
            await made.run(robots)

    try:
        data = file.read_bytes()
    except OSError as error:
        raise click.ClickException(f"'{file}': {error.strerror}") from None
    try:
        asyncio.run(run(data))
    except (RollOutError, RcpError, OSError, ValueError) as error:
        raise click.ClickException(str(error)) from None


def _fleet_of(backends: tuple[BackendConfig, ...], config: Path) -> BackendConfig:
    for backend in backends:
        if backend.use == "fleet" and backend.options.get("key") is not None:
            return backend
    raise ConfigError(f"{config} has no backend `fleet` with a `key`")


def _tables(
    gateway: str,
    backend: BackendConfig,
    routers: tuple[str, ...],
    roles: tuple[str, ...],
    *,
    has_fleet_key: bool,
) -> str:
    """Write the tables for the robot's configuration."""
    from rcp_hubs.signer import public_pem, read_private_key

    public = public_pem(read_private_key(backend.options["key"], "`key`"))
    files = '{ ca = "{folder}/ca.pem", certificate = "{folder}/gateway.pem", '
    lines = [
        "[transports.zenoh]",
        f"tenant = {json.dumps(backend.tenant)}",
        f"gateway = {json.dumps(gateway)}",
        f"connect = {json.dumps(routers)}",
        *(['fleet_key = "{folder}/fleet.key.pub"'] if has_fleet_key else []),
        f'tls = {files}key = "{{folder}}/gateway.key" }}',
        "",
        "[[hubs]]",
        f"id = {json.dumps(backend.options['hub'])}",
        f"roles = {json.dumps(roles)}",
        f'public_key = """\n{public}"""',
    ]
    return "\n".join(lines) + "\n"


def _authority(certificate: str, key: str) -> CertificateSigner:
    from cryptography.hazmat.primitives.serialization import load_pem_private_key
    from cryptography.x509 import load_pem_x509_certificate

    from rcp_hubs.enrolment import CertificateSigner

    return CertificateSigner(
        load_pem_x509_certificate(Path(certificate).read_bytes()),
        load_pem_private_key(Path(key).read_bytes(), None),
    )


@click.command(cls=_Command)
@click.argument("address", metavar="HOST:PORT")
@click.option("--config", type=click.Path(path_type=Path), default="rcp.toml", show_default=True)
@click.option(
    "--folder", type=click.Path(path_type=Path), default="fleet", help="For keys and certificates."
)
@click.option("--code", prompt=True, help="From `rcpd fleet invite`.")
def enroll(address: str, *, config: Path, folder: Path, code: str) -> None:
    """Join this robot's gateway to a fleet by a one-time code of `rcpd fleet invite`."""
    from rcp_gateway.server import prepare
    from rcp_hubs.enrolment import EnrolmentError, enrol
    from rcp_kernel.config.file import load

    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise click.BadParameter("write HOST:PORT", param_hint="HOST:PORT")
    try:
        found = load(config)
        if "zenoh" in found.transports or found.hubs:
            raise ConfigError(
                f"{config} belongs to a fleet: remove [transports.zenoh] and [[hubs]]"
            )
        before = config.read_text(encoding="utf-8")
        tables = enrol(host, int(port), code, folder)
        config.write_text(f"{before.rstrip()}\n\n{tables}", encoding="utf-8")
    except (ConfigError, EnrolmentError, OSError) as error:
        raise click.ClickException(str(error)) from None
    try:
        prepare(load(config), str(config))
    except StartupError as error:
        config.write_text(before, encoding="utf-8")
        raise click.ClickException(f"{error}\n{config} is as before. To add:\n\n{tables}") from None
    click.echo(f"{config} is enrolled; the files are in {folder}. Restart the gateway.")
