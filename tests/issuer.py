"""An issuer of JSON Web Tokens on loopback: real keys, a real HTTP server that does as a test says."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing, suppress
from typing import Any
from urllib.parse import parse_qsl

import jwt
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from kernel.world import World

AUDIENCE = "rcp-of-this-test"
_MAKERS = {
    "RS256": lambda: rsa.generate_private_key(65537, 2048),
    "ES256": lambda: ec.generate_private_key(ec.SECP256R1()),
    "EdDSA": ed25519.Ed25519PrivateKey.generate,
}


class Key:
    """A private key with its name."""

    def __init__(self, name: str, algorithm: str) -> None:
        self.name = name
        self.algorithm = algorithm
        self.private: Any = _MAKERS[algorithm]()

    @property
    def pem(self) -> str:
        """The public part."""
        public = self.private.public_key()
        return public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()

    @property
    def jwk(self) -> dict[str, Any]:
        """The public part."""
        algorithm = jwt.get_algorithm_by_name(self.algorithm)
        made = algorithm.to_jwk(self.private.public_key(), as_dict=True)
        return {**made, "kid": self.name, "use": "sig"}


class Issuer:
    """Signs tokens, and answers for its keys."""

    def __init__(self, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}"
        self.keys: dict[str, Key] = {}
        self.listed: list[str] = []
        """Names of the keys that the server tells of."""
        self.body: bytes | None = None
        """Instead of the key set."""
        self.status = b"200 OK"
        self.named: str | None = None
        """Issuer of the discovery document, if it is to be another."""
        self.more: dict[str, Any] = {}
        """What else the discovery document says."""
        self.exchanged: bytes | None = None
        """What a code is exchanged for; None: nothing is answered."""
        self.asking: list[tuple[str, dict[str, str]]] = []
        """The head and form of each exchange."""
        self.go = asyncio.Event()
        self.go.set()
        self.asked = 0
        self._writers: set[asyncio.StreamWriter] = set()

    def add(self, name: str, algorithm: str = "ES256") -> Key:
        """Make a key and tell of it."""
        self.keys[name] = Key(name, algorithm)
        self.listed.append(name)
        return self.keys[name]

    def token(self, key: str = "k1", **claims: Any) -> str:
        """Sign a token; a claim that is None is left out."""
        now = int(time.time())
        whole = {"iss": self.url, "aud": AUDIENCE, "sub": "ann", "iat": now, "exp": now + 600}
        whole = {name: value for name, value in {**whole, **claims}.items() if value is not None}
        used = self.keys[key]
        return jwt.encode(whole, used.private, used.algorithm, headers={"kid": key})

    def table(self, more: str = 'role = "operator"', source: str = "discovery = true") -> str:
        """Write the issuer's part of a configuration."""
        return f'[[jwt]]\nissuer = "{self.url}"\naudience = "{AUDIENCE}"\n{source}\n{more}\n'

    async def close(self) -> None:
        """Let nobody wait, and whoever is on the way come in before the door is shut."""
        self.go.set()
        for thread in threading.enumerate():
            if thread.name == "rcp-fetch":
                await asyncio.to_thread(thread.join, 10)
        for _ in range(3):
            await asyncio.sleep(0)
        for writer in self._writers:
            writer.transport.abort()
            with suppress(ConnectionError):
                await writer.wait_closed()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one request."""
        self._writers.add(writer)
        with closing(writer), suppress(ConnectionError, asyncio.IncompleteReadError):
            head = await reader.readuntil(b"\r\n\r\n")
            self.asked += 1
            await self.go.wait()
            if head.startswith(b"POST"):
                length = int(head.lower().partition(b"content-length:")[2].split()[0])
                form = (await reader.readexactly(length)).decode()
                self.asking.append((head.decode(), dict(parse_qsl(form))))
                if self.exchanged is None:
                    return
                body = self.exchanged
            elif b"openid-configuration" in head:
                facts = {"issuer": self.named or self.url, "jwks_uri": self.url + "/keys"}
                body = json.dumps(facts | self.more).encode()
            else:
                known = [self.keys[name].jwk for name in self.listed]
                body = self.body or json.dumps({"keys": known}).encode()
            lines = b"HTTP/1.1 %b\r\nLocation: %b/\r\nContent-Length: %d\r\n\r\n"
            writer.write(lines % (self.status, self.url.encode(), len(body)) + body)
            await writer.drain()


@asynccontextmanager
async def issuing() -> AsyncGenerator[Issuer]:
    """Run an issuer while entered; it has one key, `k1`."""
    issuer = Issuer(0)
    server = await asyncio.start_server(issuer.serve, "127.0.0.1", 0)
    issuer.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    issuer.add("k1")
    try:
        yield issuer
    finally:
        await issuer.close()
        server.close()


async def who(world: World, token: str) -> Any:
    """Return whom a token makes somebody at a gateway's client_api."""
    return await world.server.client_api.identify(token)
