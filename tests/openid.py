"""A certified OpenID provider on loopback, and the configuration of a gateway whose people log in there."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import jwt
import pytest

from issuer import Key
from node import node, npm_packages
from rcp_jwt import documents, issuers

__all__ = ["CLIENT", "SECRET", "Provider", "login_table", "patience", "providing"]

SCRIPT = Path(__file__).parent / "npm" / "oidc" / "provider.mjs"
CLIENT = "gateway of this test"  # a space and a plus tell whether its encoding is right
SECRET = "a+secret of this/test, long enough"
PEOPLE = {"ann": ["drivers"], "eve": []}
_BOUND = 60.0  # s that the program may take to answer


def login_table(issuer: str, port: int, more: str = "", scheme: str = "http") -> str:
    """Write the configuration of a gateway whose people log in at an issuer."""
    return f"""
[[jwt]]
issuer = "{issuer}"
audience = "programs of this test"
discovery = true
role_claim = "groups"
{more}
[jwt.by_claim]
drivers = {{ role = "operator", tenants = ["alpha"] }}

[jwt.login]
id = "house"
name = "House & Co"
url = "{scheme}://127.0.0.1:{port}"
client_id = "{CLIENT}"
client_secret = "{SECRET}"
"""


@contextmanager
def patience() -> Generator[None]:
    """Give an issuer the time that it may take on a machine that is busy otherwise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "_PATIENCE", _BOUND)
        patch.setattr(issuers, "_WAIT", _BOUND)
        yield


class Provider:
    """The program, and the keys with which it signs."""

    def __init__(self, process: asyncio.subprocess.Process, url: str) -> None:
        self._process = process
        self.url = url
        self.keys = [Key("first", "RS256")]

    async def serve(self, port: int, scheme: str = "http") -> None:
        """Have it serve the gateway at a port, with the keys of now."""
        client = {
            "client_id": CLIENT,
            "client_secret": SECRET,
            "redirect_uris": [f"{scheme}://127.0.0.1:{port}/rcp/v1/login/oidc/house/callback"],
            "response_types": ["code"],
            "grant_types": ["authorization_code"],
        }
        keys = [_private(key) for key in self.keys]
        await self._say({"client": client, "keys": keys, "people": PEOPLE})

    async def _say(self, message: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(message).encode() + b"\n")
        await _line(self._process)


def _private(key: Key) -> dict[str, Any]:
    algorithm = jwt.get_algorithm_by_name(key.algorithm)
    made = algorithm.to_jwk(key.private, as_dict=True)
    return {**made, "kid": key.name, "use": "sig", "alg": key.algorithm}


async def _line(process: asyncio.subprocess.Process) -> Any:
    assert process.stdout is not None
    async with asyncio.timeout(_BOUND):
        while True:
            line = await process.stdout.readline()
            assert line, "the provider has ended"
            if line.startswith(b"{"):  # the rest is advice to whoever sets one up
                return json.loads(line)


@asynccontextmanager
async def providing(folder: Path) -> AsyncGenerator[Provider]:
    """Run a provider while entered."""
    packages = npm_packages("oidc")
    (folder / "node_modules").symlink_to(packages / "node_modules")
    shutil.copy(SCRIPT, folder)
    process = await asyncio.create_subprocess_exec(
        *(node(), "--no-warnings", str(folder / SCRIPT.name)),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        with patience():
            yield Provider(process, (await _line(process))["url"])
    finally:
        process.kill()
        await process.wait()
