"""The files with which a new gateway starts: configuration, keys, certificate, systemd unit."""

from __future__ import annotations

import getpass
import os
import re
import secrets
import shlex
import shutil
import sys
from contextlib import suppress
from importlib.resources import files
from ipaddress import ip_address
from pathlib import Path

import msgspec

from rcp_kernel.contract.identity import fingerprint
from rcp_kernel.errors import ConfigError

__all__ = ["ROBOTS", "Answers", "is_local", "starter_files", "write_files"]

ROBOTS = ("sim", "mujoco", "ros2", "mavlink", "can")
"""The backends that a new configuration may begin with."""
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}\Z")
_ODD = re.compile(r'["\\$\x00-\x1f\x7f]')
"""What means something else in TOML, in `${NAME}` or in a unit, quoted or not."""
_TLS = """
[transports.asgi.tls] # clients need it: rcpctl --cacert tls/gateway.pem
certificate = "{folder}/tls/gateway.pem"
key = "{folder}/tls/gateway.key"
"""


class Answers(msgspec.Struct, frozen=True, kw_only=True):
    """What a new gateway is to be."""

    folder: Path
    """Absolute."""
    state: Path
    """Where its store is, absolute."""
    use: str
    name: str
    robot: str
    tenant: str
    host: str
    port: int
    user: str
    """Who runs it as a service."""


def is_local(host: str) -> bool:
    """Return whether only this machine reaches an address to listen on."""
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


def starter_files(answers: Answers) -> dict[Path, bytes]:
    """Return the files of a new gateway, with keys made for it.

    :raises ConfigError: a name does not fit, or no certificate can be made.
    """
    for what in ("name", "robot", "tenant"):
        if not _NAME.match(getattr(answers, what)):
            raise ConfigError(
                f"--{what} {getattr(answers, what)[:64]!r}: write 1 to 64 letters, digits, `_`, "
                "`.` or `-`"
            )
    for what in ("folder", "state", "host"):
        if _ODD.search(text := str(getattr(answers, what))):
            option = {"folder": "into"}.get(what, what)
            raise ConfigError(
                f"--{option} {text!r}: choose one without quotation marks, backslashes, dollar "
                "signs and control characters"
            )
    folder, local = answers.folder, is_local(answers.host)
    keys = {name: f"rcp_{name[:2]}_{secrets.token_urlsafe(24)}" for name in ("operator", "admin")}
    facts = {
        "file": shlex.quote(str(folder / "rcp.toml")),
        "anonymous": '{ role = "viewer" } # whoever is on this machine may read'
        if local
        else "false",
        "tls": "" if local else _TLS.format(folder=folder),
        **{name: fingerprint(key) for name, key in keys.items()},
        **{what: str(getattr(answers, what)) for what in ("name", "state", "host", "port")},
    }
    robot = {what: getattr(answers, what) for what in ("robot", "tenant")}
    text = _filled("rcp.toml", {**facts, "robot": _filled(f"robot_{answers.use}.toml", robot)})
    found = {
        **{folder / f"{name}.key": f"{key}\n".encode() for name, key in keys.items()},
        folder / "rcp-gateway.service": _unit(answers).encode(),
    }
    if not local:
        certificate, key = _certificate(answers.host)
        found |= {folder / "tls/gateway.pem": certificate, folder / "tls/gateway.key": key}
    # Last, because it says that all the others are there.
    return {**found, folder / "rcp.toml": text.encode()}


def _certificate(host: str) -> tuple[bytes, bytes]:
    try:
        from rcpd.self_signed import self_signed
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"--host {host}: no certificate can be made ({error}); try: "
            "pip install 'rcp-gateway[tls]', or listen on 127.0.0.1"
        ) from None
    return self_signed(host)


def write_files(found: dict[Path, bytes], *, replace: bool, user: str | None = None) -> None:
    """Write files that only their owner can read; without `replace`, none if one is there.

    Written by root for another `user`, they belong to that one.

    :raises ConfigError: one is there, or cannot be written.
    """
    there = [str(path) for path in found if path.exists() or path.is_symlink()]
    if there and not replace:
        raise ConfigError(
            f"already there, nothing was written: {', '.join(there)}. Choose another folder with "
            "--into, or replace them with --force: clients then need the new keys"
        )
    owner = _owner(user)
    for path, data in found.items():
        _write(path, data, owner, replace=replace)


def _write(path: Path, data: bytes, owner: int | None, *, replace: bool) -> None:
    try:
        made = [] if path.parent.exists() else [path.parent]
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if replace:
            path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
            out.write(data)
        if owner is not None:
            for own in (*made, path):
                shutil.chown(own, owner)
    except OSError as error:
        raise ConfigError(
            f"'{error.filename or path}' cannot be written: {error.strerror or error}. Choose "
            "another folder with --into"
        ) from None


def _owner(user: str | None) -> int | None:
    """Return who gets what root writes; None if it stays with whoever writes it."""
    if user is None or os.geteuid() != 0 or user == getpass.getuser():
        return None
    import pwd  # not everywhere

    try:
        return pwd.getpwnam(user).pw_uid
    except KeyError:
        raise ConfigError(
            f"there is no user '{user}': create it first, or choose another one with --user"
        ) from None


def _unit(answers: Answers) -> str:
    program = shutil.which("rcpd", path=str(Path(sys.executable).parent)) or shutil.which("rcpd")
    rcpd = _word(program) if program else f"{_word(sys.executable)} -m rcpd"
    homes = [Path(name) for name in ("/home", "/root", "/run/user")]
    at_home = any(
        path.is_relative_to(home)
        for path in (Path(program or sys.executable), answers.folder, answers.state)
        for home in homes
    )
    return _filled(
        "rcp-gateway.service",
        {
            "rcpd": rcpd,
            "config": _word(str(answers.folder / "rcp.toml")),
            "secrets": str(answers.folder / "secrets.env").replace("%", "%%"),  # a line, no words
            "home": _word(f"HOME={answers.state}"),
            "state": _word(f"-{answers.state}"),
            "user": answers.user,
            "homes": "read-only" if at_home else "true",
            "devices": "true" if answers.use == "sim" else "false",
        },
    )


def _word(text: str) -> str:
    """Return a word as a unit has it: `%` begins a specifier there, and spaces end a word."""
    text = text.replace("%", "%%")
    return text if re.fullmatch(r"[\w@%+=:,./-]+", text, re.ASCII) else f'"{text}"'


def _filled(template: str, facts: dict[str, str]) -> str:
    text = files("rcpd").joinpath("templates", f"{template}.in").read_text(encoding="utf-8")
    return re.sub(r"@([a-z]+)@", lambda mark: facts[mark[1]], text)
