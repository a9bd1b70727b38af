"""Enrolment of a robot by a one-time code: it gets its certificate, and what it must know of hubs.

The code is a secret and the fingerprint of the certificate that the invitation is served with, so
that each end knows the other. The robot's private key never leaves it, and the CA's stays where
the invitation was made.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
import socket
import ssl
import tempfile
import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec import Meta

__all__ = ["CertificateSigner", "EnrolmentError", "Identity", "Invitation", "enrol"]

_SECRET, _PRINT = 10, 16  # bytes
_ATTEMPTS = 5
_PATIENCE = 5.0  # s for one robot, or for the hub's answer
_LONGEST = 65_536  # bytes of a message


class EnrolmentError(Exception):
    """Enrolment failed; the text says why."""


class Identity(msgspec.Struct, frozen=True, kw_only=True):
    """What a robot's gateway gets."""

    configuration: str
    """Tables for its configuration file; `{folder}` stands for where the files are."""
    ca: str
    certificate: str = ""
    fleet_key: str | None = None


class _Request(msgspec.Struct, frozen=True):
    secret: Annotated[str, Meta(max_length=64)]
    csr: Annotated[str, Meta(max_length=8192)]


class _Reply(msgspec.Struct, frozen=True):
    identity: Identity | None = None
    error: str | None = None


class CertificateSigner(msgspec.Struct, frozen=True):
    """The CA of the fleet."""

    certificate: x509.Certificate
    key: Any


def _signed(authority: CertificateSigner, csr: str, gateway: str, days: float) -> str:
    """Sign the key of a request, as that of a gateway; its other wishes do not count.

    :raises EnrolmentError: it is no request, or does not prove its key.
    """
    try:
        request = x509.load_pem_x509_csr(csr.encode())
        proved = request.is_signature_valid
    except Exception:  # untrusted input
        proved, request = False, None
    if request is None or not proved:
        raise EnrolmentError("the robot's certificate request is not valid")
    now = datetime.now(UTC)
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    made = (
        x509.CertificateBuilder()
        .subject_name(_named(gateway))
        .issuer_name(authority.certificate.subject)
        .public_key(request.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(minutes=5))
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .sign(authority.key, hashes.SHA256())
    )
    return made.public_bytes(Encoding.PEM).decode()


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


class Invitation:
    """One robot's invitation, served on a port until it was used or has expired. Blocks."""

    def __init__(
        self,
        gateway: str,
        identity: Identity,
        authority: CertificateSigner,
        *,
        days: float = 365.0,
        port: int = 0,
        host: str = "",
    ) -> None:
        """Open the port.

        :raises OSError: it cannot be opened.
        """
        self._gateway, self._identity, self._authority = gateway, identity, authority
        self._days = days
        self._secret = secrets.token_bytes(_SECRET)
        self._context, fingerprint = _temporary_server()
        self._socket = socket.create_server((host, port))
        self.port: int = self._socket.getsockname()[1]
        self.code = base64.b32encode(self._secret + fingerprint).decode().rstrip("=").lower()
        """What the robot's operator types."""
        self._left = _ATTEMPTS

    def serve(self, seconds: float) -> None:
        """Wait for the robot.

        :raises EnrolmentError: the time is over, or too many codes were wrong.
        """
        end = time.monotonic() + seconds
        with self._socket:
            while True:
                left = end - time.monotonic()
                if left <= 0:
                    raise EnrolmentError("the code has expired")
                self._socket.settimeout(left)
                with suppress(TimeoutError, OSError, ssl.SSLError):
                    connection, _ = self._socket.accept()
                    with connection:
                        connection.settimeout(_PATIENCE)
                        with self._context.wrap_socket(connection, server_side=True) as secured:
                            if self._handle(secured):
                                return
                if not self._left:
                    raise EnrolmentError(f"{_ATTEMPTS} wrong codes: make another invitation")

    def _handle(self, connection: ssl.SSLSocket) -> bool:
        try:
            reply = _Reply(identity=self._answer(_receive(connection)))
        except EnrolmentError as error:
            reply = _Reply(error=str(error))
        connection.sendall(msgspec.json.encode(reply) + b"\n")
        return reply.identity is not None

    def _answer(self, data: bytes) -> Identity:
        try:
            request = msgspec.json.decode(data, type=_Request)
            offered = bytes.fromhex(request.secret)
        except (msgspec.DecodeError, ValueError):
            raise EnrolmentError("the request is malformed") from None
        if not hmac.compare_digest(offered, self._secret):
            self._left -= 1
            raise EnrolmentError("the code is wrong")
        signed = _signed(self._authority, request.csr, self._gateway, self._days)
        return msgspec.structs.replace(self._identity, certificate=signed)


def _receive(connection: ssl.SSLSocket) -> bytes:
    """Read one line, within a bound in size and time."""
    data, end = b"", time.monotonic() + _PATIENCE
    while not data.endswith(b"\n"):
        part = connection.recv(4096)
        data += part
        if not part or len(data) > _LONGEST or time.monotonic() > end:
            raise EnrolmentError("the message is not complete")
    return data


def _temporary_server() -> tuple[ssl.SSLContext, bytes]:
    """Return a TLS context with a certificate for this purpose only, and its fingerprint."""
    key = ec.generate_private_key(ec.SECP256R1())
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(_named("rcp enrolment"))
        .issuer_name(_named("rcp enrolment"))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=30))
        .sign(key, hashes.SHA256())
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    with tempfile.NamedTemporaryFile() as file:  # readable only by its owner
        form = PrivateFormat.PKCS8
        file.write(key.private_bytes(Encoding.PEM, form, NoEncryption()))
        file.write(made.public_bytes(Encoding.PEM))
        file.flush()
        context.load_cert_chain(file.name)
    return context, _fingerprint(made.public_bytes(Encoding.DER))


def _fingerprint(certificate: bytes) -> bytes:
    return hashlib.sha256(certificate).digest()[:_PRINT]


def enrol(host: str, port: int, code: str, folder: Path) -> str:
    """Get a robot's identity: write its files to a folder, return the tables to configure.

    :raises EnrolmentError: the hub cannot be reached, is another one, or refuses the code.
    """
    secret, fingerprint = _parts(code)
    key = ec.generate_private_key(ec.SECP256R1())
    request = x509.CertificateSigningRequestBuilder().subject_name(_named("robot"))
    csr = request.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM).decode()
    found = _ask(host, port, fingerprint, _Request(secret.hex(), csr))
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        files = {
            "gateway.key": pem,
            "gateway.pem": found.certificate,
            "ca.pem": found.ca,
            "fleet.key.pub": found.fleet_key,
        }
        for name, text in files.items():
            if text is not None:
                file = folder / name
                file.touch(mode=0o600)
                file.chmod(0o600)
                file.write_text(text, encoding="ascii")
    except OSError as error:
        raise EnrolmentError(f"'{folder}' cannot be written: {error.strerror}") from None
    return found.configuration.replace("{folder}", str(folder.absolute()))


def _parts(code: str) -> tuple[bytes, bytes]:
    text = code.strip().replace("-", "").upper()
    try:
        whole = base64.b32decode(text + "=" * (-len(text) % 8))
    except ValueError:
        whole = b""
    if len(whole) != _SECRET + _PRINT:
        raise EnrolmentError("this is not a whole code: copy it from `rcpd fleet invite`")
    return whole[:_SECRET], whole[_SECRET:]


def _ask(host: str, port: int, fingerprint: bytes, request: _Request) -> Identity:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False  # the code has the fingerprint instead
    context.verify_mode = ssl.CERT_NONE
    try:
        with (
            socket.create_connection((host, port), timeout=_PATIENCE) as plain,
            context.wrap_socket(plain) as connection,
        ):
            shown = _fingerprint(connection.getpeercert(binary_form=True) or b"")
            if not hmac.compare_digest(shown, fingerprint):
                raise EnrolmentError("the code is of another invitation, or someone is in between")
            connection.sendall(msgspec.json.encode(request) + b"\n")
            reply = msgspec.json.decode(_receive(connection), type=_Reply)
    except OSError as error:
        raise EnrolmentError(f"{host}:{port} cannot be reached: {error}") from None
    except msgspec.DecodeError:
        raise EnrolmentError(f"{host}:{port} gives no valid answer") from None
    if reply.identity is None:
        raise EnrolmentError(reply.error or "refused")
    return reply.identity
