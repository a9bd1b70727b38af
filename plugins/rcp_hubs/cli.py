"""`rcpd fleet`: the keys of hubs and of the fleet, and their revocation."""

from __future__ import annotations

import os
from pathlib import Path

import click

from rcp_kernel.errors import ConfigError, Unauthenticated

__all__ = ["fleet"]


@click.group()
def fleet() -> None:
    """Make keys of hubs and of the fleet, and revoke those of hubs."""


@fleet.command()
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


@fleet.command()
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
