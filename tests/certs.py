"""Certificates for tests: a CA, what it signs, and its list of what is revoked."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

_DAY = timedelta(days=1)
_USES = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]


class Signed:
    """A certificate with its key, in files."""

    def __init__(self, certificate: x509.Certificate, cert: Path, key: Path) -> None:
        self.certificate = certificate
        self.cert = cert
        self.key = key

    @property
    def pair(self) -> tuple[str, str]:
        return str(self.cert), str(self.key)


class Authority:
    """A CA that keeps its files in a folder."""

    def __init__(self, folder: Path, name: str = "Test CA") -> None:
        self._folder = folder
        self.private = ec.generate_private_key(ec.SECP256R1())
        self.subject = _named(name)
        self._revoked: list[x509.Certificate] = []
        usage = x509.KeyUsage(
            digital_signature=True,
            content_commitment=False,
            key_encipherment=False,
            data_encipherment=False,
            key_agreement=False,
            key_cert_sign=True,
            crl_sign=True,
            encipher_only=False,
            decipher_only=False,
        )
        made = (
            self._builder(self.subject, self.private.public_key())
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
            .sign(self.private, hashes.SHA256())
        )
        self.file = folder / f"{name.replace(' ', '-').lower()}.pem"
        self.file.write_bytes(made.public_bytes(serialization.Encoding.PEM))

    def _builder(
        self,
        subject: x509.Name,
        key: ec.EllipticCurvePublicKey,
        days: tuple[float, float] = (-2, 2),
    ) -> x509.CertificateBuilder:
        begin, end = (datetime.now(UTC) + day * _DAY for day in days)
        signer = self.private.public_key()
        return (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(self.subject)
            .public_key(key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(begin)
            .not_valid_after(end)
            # Python 3.13 trusts no certificate of a CA without these.
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(signer), critical=False
            )
        )

    def sign(
        self,
        name: str,
        *,
        sans: tuple[x509.GeneralName, ...] = (),
        days: tuple[float, float] = (-1, 1),
        password: bytes | None = None,
        file: str | None = None,
    ) -> Signed:
        """Make a certificate that is good from the first to the second of `days` from now."""
        key = ec.generate_private_key(ec.SECP256R1())
        builder = self._builder(_named(name), key.public_key(), days).add_extension(
            x509.ExtendedKeyUsage(_USES), critical=False
        )
        if sans:
            builder = builder.add_extension(x509.SubjectAlternativeName(sans), critical=False)
        made = builder.sign(self.private, hashes.SHA256())
        cert = self._folder / f"{file or name}.pem"
        cert.write_bytes(made.public_bytes(serialization.Encoding.PEM))
        sealed = (
            serialization.NoEncryption()
            if password is None
            else serialization.BestAvailableEncryption(password)
        )
        private = cert.with_suffix(".key")
        private.write_bytes(
            key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, sealed)
        )
        return Signed(made, cert, private)

    def server(self, file: str = "server", password: bytes | None = None) -> Signed:
        """Make a certificate of `localhost` and 127.0.0.1."""
        loopback = x509.IPAddress(ip_address("127.0.0.1"))
        sans = (x509.DNSName("localhost"), loopback)
        return self.sign("gateway", sans=sans, file=file, password=password)

    def revoke(self, *signed: Signed) -> Path:
        """Write the list of revoked certificates, with these on it too."""
        self._revoked += [one.certificate for one in signed]
        now = datetime.now(UTC)
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self.subject)
            .last_update(now - _DAY)
            .next_update(now + _DAY)
        )
        for one in self._revoked:
            builder = builder.add_revoked_certificate(
                x509.RevokedCertificateBuilder()
                .serial_number(one.serial_number)
                .revocation_date(now - _DAY)
                .build()
            )
        made = builder.sign(self.private, hashes.SHA256())
        file = self._folder / "crl.pem"
        file.write_bytes(made.public_bytes(serialization.Encoding.PEM))
        return file


def _named(common: str) -> x509.Name:
    parts = [(NameOID.ORGANIZATION_NAME, "Example"), (NameOID.COMMON_NAME, common)]
    return x509.Name([x509.NameAttribute(oid, text) for oid, text in parts])
