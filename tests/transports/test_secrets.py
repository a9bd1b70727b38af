"""No secret is told again: not in answers, not in the log, the record, the store, or by a command.

A real `rcpd` in a process of its own, logging all it can, is shown every kind of secret on every way
there is, good ones, bad ones and misplaced ones; then whatever it said is searched for them.
"""

from __future__ import annotations

import asyncio
import base64
import json
import os
import re
import secrets
import signal
import ssl
import sys
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import jwt
import pytest
from websockets.asyncio.client import connect

from certs import Authority, Signed
from issuer import Key

pytestmark = pytest.mark.anyio
BIN = Path(sys.executable).parent
BOUND = 60.0  # s
ISSUER, AUDIENCE = "https://issuer.example", "rcp-of-this-test"
POSE = "/tenant/alpha/sensor/pose"
CONTEXT = "/rcp/v1/context"
CONFIG = """
anonymous = false
[transports.asgi]
port = 0
[transports.asgi.tls]
certificate = "{server.cert}"
key = "{server.key}"
key_password = "${{SEAL}}"
client_ca = "{ca}"
client_certificates = "optional"
[log]
level = "debug"
format = "json"
[store]
path = "{folder}/store.db"
[limits]
failed_logins = 1000
[[backends]]
use = "sim"
tenant = "alpha"
[[keys]]
name = "written"
role = "admin"
key = "{written}"
[[keys]]
name = "named"
role = "operator"
key = "${{NAMED}}"
[[certificates]]
name = "fleet"
subject = "fleet"
role = "operator"
[[jwt]]
issuer = "https://issuer.example"
audience = "rcp-of-this-test"
keys = "{folder}/issuer.pem"
role = "operator"
leeway = 0
"""


class Secrets:
    """What must not be heard again, and all that was heard."""

    def __init__(self) -> None:
        self._known: dict[str, str] = {}
        self.heard: list[tuple[str, str]] = []

    def keep(self, name: str, text: str) -> str:
        """Know a secret, also in base64; return it."""
        self._known[name] = text
        self._known[f"{name}, in base64"] = base64.b64encode(text.encode()).decode().rstrip("=")
        return text

    def keep_pem(self, name: str, file: Path) -> None:
        """Know the lines of a PEM file."""
        for number, line in enumerate(file.read_text().splitlines()[1:-1], 1):
            if len(line) > 40:  # the last one may be too short to mean anything
                self.keep(f"{name}, line {number}", line)

    def hear(self, where: str, text: str | bytes) -> None:
        """Note what somebody was told."""
        told = text if isinstance(text, str) else text.decode("utf-8", "replace")
        self.heard.append((where, told))

    def found(self) -> list[tuple[str, str]]:
        """List each secret that was heard, with where."""
        return [
            (name, where)
            for where, told in self.heard
            for name, text in self._known.items()
            if text in told
        ]


class Gateway:
    """`rcpd serve` and what it prints."""

    def __init__(self, folder: Path, kept: Secrets) -> None:
        self.folder = folder
        self.kept = kept
        ca = Authority(folder)
        seal = kept.keep("key password", secrets.token_urlsafe(16))
        self.ca = ca.file
        self.server = ca.server(password=seal.encode())
        self.fleet: Signed = ca.sign("fleet")
        for signed in (self.server, self.fleet):
            kept.keep_pem(f"{signed.cert.name}", signed.cert)
            kept.keep_pem(f"{signed.key.name}", signed.key)
        self.issuer = Key("k1", "ES256")
        (folder / "issuer.pem").write_text(self.issuer.pem)
        self.written = kept.keep("key of the file", "w-" + secrets.token_urlsafe(24))
        self.named = kept.keep("key of the environment", "n-" + secrets.token_urlsafe(24))
        self.environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith("RCP_")},
            "HOME": str(folder),
            "PYTHONPATH": ":".join(sys.path),
            "SEAL": seal,
            "NAMED": self.named,
        }
        self.config = folder / "rcp.toml"
        self.text = CONFIG.format(
            folder=folder, ca=ca.file, server=self.server, written=self.written
        )
        self.config.write_text(self.text)
        self.url = ""
        self.token = ""
        self._news = asyncio.Event()
        self._lines: list[str] = []

    def jwt(self, name: str, **claims: Any) -> str:
        """Sign a token, and know it by its signature too."""
        now = int(time.time())
        whole = {"iss": ISSUER, "aud": AUDIENCE, "sub": "ann", "iat": now, "exp": now + 600}
        token = jwt.encode({**whole, **claims, "jti": name}, self.issuer.private, "ES256")
        self.kept.keep(f"signature of {name}", token.rpartition(".")[2])
        return self.kept.keep(name, token)

    async def run(self, program: str, *words: str, **env: str) -> tuple[int, str]:
        """Run a command line to its end; note all that it says, and return its output."""
        made = await asyncio.create_subprocess_exec(
            BIN / program,
            *words,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**self.environment, **env},
        )
        out, error = await asyncio.wait_for(made.communicate(), BOUND)
        place = f"{program} {words[0]}"
        self.kept.hear(place, error)
        if words[:2] != ("token", "create"):
            self.kept.hear(place, out)
        return made.returncode or 0, out.decode()

    async def said(self, text: str) -> str:
        """Wait for a line of its log."""
        async with asyncio.timeout(BOUND):
            while True:
                for line in self._lines:
                    if text in line:
                        return line
                self._news.clear()
                await self._news.wait()

    @asynccontextmanager
    async def serving(self) -> AsyncGenerator[asyncio.subprocess.Process]:
        """Serve while entered; note the whole log."""
        process = await asyncio.create_subprocess_exec(
            BIN / "rcpd",
            "serve",
            self.config,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=self.environment,
        )
        reading = asyncio.create_task(self._read(process))
        try:
            self.url = (await self.said("rcpd: serving on")).split()[-1]
            yield process
        finally:
            with suppress(ProcessLookupError):
                process.terminate()
            await asyncio.wait_for(process.wait(), BOUND)
            await reading
            self.kept.hear("the log", "".join(self._lines))

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            self._lines.append(line.decode())
            self._news.set()

    def context(self, client: Signed | None = None) -> ssl.SSLContext:
        """Trust the gateway, and show a certificate."""
        made = ssl.create_default_context(cafile=self.ca)
        if client is not None:
            made.load_cert_chain(*client.pair)
        return made


@pytest.fixture
async def gateway(tmp_path: Path) -> AsyncGenerator[Gateway]:
    made = Gateway(tmp_path, Secrets())
    _, out = await made.run("rcpd", "token", "create", "t", "--role", "admin", *of(made))
    made.token = made.kept.keep("token", out.strip())
    async with made.serving():
        yield made
    assert "the log" in dict(made.kept.heard)
    assert made.kept.found() == []


def of(gateway: Gateway) -> tuple[str, str]:
    return "--config", str(gateway.config)


async def over_http(gateway: Gateway, token: str | None, client: Signed | None = None) -> None:
    """Ask for all there is, as whoever a token or certificate proves."""
    headers = {} if token is None else {"authorization": f"Bearer {token}"}
    async with httpx.AsyncClient(
        base_url=gateway.url, verify=gateway.context(client), headers=headers, timeout=BOUND
    ) as http:
        system = ("status", "sessions", "commands", "leases", "estop", "log", "audit", "plugins")
        for path in (
            *("/", "/healthz", "/readyz", "/metrics", "/openapi.json"),
            *("/rcp/v1/discovery", "/rcp/v1/status", CONTEXT + POSE),
            *(f"{CONTEXT}/system/{name}" for name in system),
            f"{CONTEXT}/system/nothing",
        ):
            hear(gateway, await http.get(path))
        hear(gateway, await http.put(CONTEXT + "/tenant/alpha/param/speed_limit", json=1.0))
        hear(gateway, await http.put(CONTEXT + "/tenant/alpha/param/speed_limit", json="no"))
        lease = {"do": "acquire", "scope": "/tenant/alpha"}
        hear(gateway, await http.post(CONTEXT + "/system/leases", json=lease))
        lease["do"] = "release"
        hear(gateway, await http.post(CONTEXT + "/system/leases", json=lease))


def hear(gateway: Gateway, answer: httpx.Response) -> None:
    place = f"{answer.request.method} {answer.request.url.path}"
    gateway.kept.hear(place, f"{answer.status_code} {dict(answer.headers)}\n{answer.text}")


async def over_websocket(gateway: Gateway, token: str | None, client: Signed | None = None) -> None:
    """Say `hello` with a token in it, come back, ask what sessions there are, watch the record."""
    url = gateway.url.replace("https", "wss") + "/rcp/v1/ws"
    resumed: str | None = None
    for _ in range(2):
        async with connect(url, ssl=gateway.context(client)) as wire:

            async def ask(**envelope: Any) -> dict[str, Any]:
                await wire.send(json.dumps(envelope))
                async with asyncio.timeout(BOUND):
                    while True:
                        told = json.loads(await wire.recv())
                        if told.get("id") == envelope.get("id"):
                            break
                        gateway.kept.hear("a notice or update over WebSocket", json.dumps(told))
                if told.get("status") == "completed" and "resume_token" in (told["body"] or {}):
                    return told  # whose it is may know it
                gateway.kept.hear(f"{envelope['type']} over WebSocket", json.dumps(told))
                return told

            body = {"token": token, "resume_token": resumed, "session": resumed}
            greeting = await ask(
                type="hello", id="h", body={k: v for k, v in body.items() if v is not None}
            )
            if greeting["status"] != "completed":
                return
            resumed = gateway.kept.keep("resume token", greeting["body"].pop("resume_token"))
            gateway.kept.hear("hello over WebSocket", json.dumps(greeting))
            await ask(type="subscribe", id="s", path="/system/audit")
            await ask(type="read", id="r", path="/system/sessions")
            await ask(type="discover", id="d", path="/**")
            await ask(type="hello", id="again", body={"token": f"{token}x"})


async def over_cookie(gateway: Gateway, token: str) -> None:
    """Log in as a page of the gateway, look around by the cookie, and log out."""
    async with httpx.AsyncClient(
        base_url=gateway.url,
        verify=gateway.context(),
        headers={"origin": gateway.url},
        timeout=BOUND,
    ) as http:
        begun = await http.post("/rcp/v1/login", json={"token": token})
        gateway.kept.hear("POST /rcp/v1/login", begun.text)
        for secret in http.cookies.values():  # which the browser alone is told
            gateway.kept.keep("login", secret)
        for name in ("sessions", "logins", "keys", "audit", "log", "status"):
            hear(gateway, await http.get(f"{CONTEXT}/system/{name}"))
        hear(gateway, await http.get("/rcp/v1/login"))
        for wrong in ({"token": [token]}, {"tokn": token}, token):
            hear(gateway, await http.post("/rcp/v1/login", json=wrong))
        cookies = "; ".join(f"{name}={value}" for name, value in http.cookies.items())
        foreign = {"origin": "https://evil.example", "cookie": cookies}
        hear(gateway, await http.put(CONTEXT + POSE, json=1, headers=foreign))
        hear(gateway, await http.delete("/rcp/v1/login"))


async def over_events(gateway: Gateway, token: str | None, client: Signed | None = None) -> None:
    """Read an event stream, over which the session is told with the first event."""
    headers = {} if token is None else {"authorization": f"Bearer {token}"}
    async with (
        httpx.AsyncClient(
            base_url=gateway.url, verify=gateway.context(client), headers=headers, timeout=BOUND
        ) as http,
        http.stream("GET", f"/rcp/v1/events?path={POSE}&path=/system/audit&count=2") as answer,
    ):
        text = ""
        async with asyncio.timeout(BOUND):
            async for line in answer.aiter_lines():
                text += line + "\n"
                if text.count("event: update") >= 2:
                    break
        gateway.kept.hear("events", f"{dict(answer.headers)}\n{text}")


async def misplaced(gateway: Gateway, secret: str) -> None:
    """Put a secret where it is not looked for."""
    async with httpx.AsyncClient(
        base_url=gateway.url, verify=gateway.context(), timeout=BOUND
    ) as http:
        for scheme in ("Basic", "Token", "Bearer x", ""):
            headers = {"authorization": f"{scheme} {secret}".strip()}
            hear(gateway, await http.get(CONTEXT + POSE, headers=headers))
        for name in ("token", "access_token", "api-key", "Authorization"):
            hear(gateway, await http.get(CONTEXT + POSE, params={name: secret}))
        headers = {"authorization": f"Bearer {gateway.written}", "last-event-id": secret}
        hear(gateway, await http.get(f"/rcp/v1/events?path={POSE}&count=1", headers=headers))
    url = gateway.url.replace("https", "wss") + "/rcp/v1/ws"
    for body in (
        {"token": [secret]},
        {"tokn": secret},
        {"session": secret, "token": gateway.written},
        {"resume_token": secret, "session": "s-0", "token": gateway.written},
        secret,
    ):
        async with connect(url, ssl=gateway.context()) as wire:
            await wire.send(json.dumps({"type": "hello", "body": body}))
            async with asyncio.timeout(BOUND):
                gateway.kept.hear(f"hello with {type(body)}", await wire.recv())


async def test_no_secret_is_told_again(gateway: Gateway) -> None:
    kept, token = gateway.kept, gateway.token
    good = [gateway.written, gateway.named, token, gateway.jwt("JWT")]
    assert len({*good}) == 4
    bad = [kept.keep(f"wrong {n}", secret + secrets.token_urlsafe(8)) for n, secret in
           enumerate(good)]  # fmt: skip
    bad += [gateway.jwt("past", exp=1_000_000_000), gateway.jwt("of others", aud="other")]
    ways = [(secret, None) for secret in (*good, *bad)] + [(None, gateway.fleet)]
    for proof, client in ways:
        await over_http(gateway, proof, client)
        await over_websocket(gateway, proof, client)
        await over_events(gateway, proof, client)
        if proof is not None:
            await over_cookie(gateway, proof)
    for secret in (token, good[3], kept.keep("stray", secrets.token_urlsafe(24))):
        await misplaced(gateway, secret)
    replies = "".join(told for _, told in kept.heard)
    assert re.search(r'"principal": ?"ann"', replies)  # it was let in, and the record was shown
    assert re.search(r'"code": ?"token_expired"', replies)
    assert kept.found() == []


async def test_no_command_shows_a_secret(gateway: Gateway) -> None:
    kept, token = gateway.kept, gateway.token
    past = gateway.jwt("past", exp=1_000_000_000)
    at = {"RCP_URL": gateway.url, "RCP_CACERT": str(gateway.ca)}
    cert = ("--cert", str(gateway.fleet.cert), "--cert-key", str(gateway.fleet.key))
    wrong = kept.keep("wrong", secrets.token_urlsafe(24))
    codes = [
        (await gateway.run("rcpctl", *words, **at))[0]
        for words in (
            ("status", "--text", "--token", token),
            ("read", "/system/sessions", "--json", "--token", gateway.jwt("JWT")),
            ("read", "/system/audit", "--token", gateway.written),
            ("status", *cert),
            ("status", "--token", wrong),
            ("read", POSE, "--token", past),
            ("status", "--token", token, "--url", "http://192.0.2.1:1"),
            ("status", "--token", token, "--cacert", str(gateway.fleet.cert)),
            ("status", "--token", token, "--cert", str(gateway.fleet.key)),
        )
    ]
    assert codes == [0, 0, 0, 0, 3, 3, 2, 4, 2]
    for words in (
        ("check", str(gateway.config)),
        ("plugins",),
        ("token", "list", "--all", *of(gateway)),
        ("audit", "export", str(gateway.config)),
        ("audit", "verify", str(gateway.config)),
        ("token", "revoke", "t", *of(gateway)),
    ):
        assert (await gateway.run("rcpd", *words))[0] == 0, words
    await gateway.said('"outcome": "revoked"')
    for file in gateway.folder.glob("store.db*"):
        kept.hear(file.name, file.read_bytes())
    assert kept.found() == []


@pytest.mark.parametrize(
    "fault",
    [
        ('role = "admin"\nkey = "', 'role = "admin"\nkey = "short", "'),
        ('role = "admin"', 'role = "nobody"'),
        ('name = "written"', "name = 1"),
        ("failed_logins = 1000", 'failed_logins = "many"'),
        ('key = "${NAMED}"', 'sha256 = "${NAMED}"'),
        ('key = "${NAMED}"', 'kee = "${NAMED}"'),
        ('audience = "rcp-of-this-test"', 'audience = ["${NAMED}", 1]'),
        ('key_password = "${SEAL}"', 'key_password = "${NAMED}"'),
        ("/issuer.pem", "/fleet.key"),
    ],
    ids=str,
)
async def test_a_faulty_file_is_told_of_without_its_secrets(
    tmp_path: Path, fault: tuple[str, str]
) -> None:
    gateway = Gateway(tmp_path, Secrets())
    assert fault[0] in gateway.text
    gateway.config.write_text(gateway.text.replace(*fault))
    assert (await gateway.run("rcpd", "check", str(gateway.config)))[0] == 1
    assert gateway.kept.heard[0][1].startswith("rcpd: ")
    assert gateway.kept.found() == []


async def test_a_reload_that_is_refused_shows_no_secret(tmp_path: Path) -> None:
    gateway = Gateway(tmp_path, Secrets())
    async with gateway.serving() as process:
        gateway.config.write_text(gateway.text.replace('role = "admin"', 'rolle = "admin"'))
        process.send_signal(signal.SIGHUP)
        assert "rolle" in await gateway.said("reload_refused")
    assert gateway.kept.found() == []
