"""Kill a gateway under load again and again, and look at what is left: run by test_crash.py.

Imports are paid once: every life of the gateway is a fork of this process, which holds no thread
and no open database at that moment. Clients are in the gateway's process, and write down what they
are told, at once, in a file of their own; so does the robot with what it is told.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import random
import signal
import sys
from collections import Counter
from collections.abc import AsyncGenerator, Generator, Iterator
from contextlib import asynccontextmanager, closing, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec

import rcp_audit
import rcp_leases
from configuration import backend, configuration, key, table
from rcp_gateway.features import active
from rcp_gateway.log import Recent, configure
from rcp_gateway.server import Prepared, Server, running
from rcp_gateway.testing import ScriptedRobot
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.values import Encoding
from rcp_store.damage import find_damage
from rcp_store.file import open_read_only
from rcp_store.latch_file import LatchFile
from rcpd.examination import examined

CONFIG = configuration(
    backend(),
    backend("leased", "beta"),
    backend("stopped", "gamma"),
    key("operator", "operator-operator"),
    key("admin", "admin-admin-admin"),
)
IN_FLIGHT = 6  # requests of each client
SCOPES = 24  # that leases are taken on
TTL = 1.0  # s of a lease
AGAIN = 60  # keys sent again in each life
KNOWN = (
    10_000  # keys: the gateway remembers the last 20,000, those sent again for the first time too
)
SHORTEST, LONGEST = 0.1, 2.0  # s that a life lasts at most once it is ready
ENOUGH = 10  # replies in a life; with fewer it was too short to see anything
FINAL = ("completed", "failed", "rejected", "cancelled")
Sent = tuple[str, dict[str, Any]]


class Journal:
    """Lines that survive whoever writes them."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_CREAT | os.O_APPEND | os.O_WRONLY)
        os.write(self._file, b"\n")  # after a line that a kill cut off

    def write(self, fact: Any) -> None:
        os.write(self._file, json.dumps(fact).encode() + b"\n")


def lines(path: Path, skip: int = 0) -> Iterator[Any]:
    """Read what was written from a place on; a line that a kill cut off says nothing."""
    data = path.read_bytes()[skip:] if path.exists() else b""
    for line in data.splitlines():
        with suppress(ValueError):
            yield json.loads(line)


class NoOptions(msgspec.Struct):
    """Nothing to configure."""


def robot(host: Host, ran: Journal) -> ScriptedRobot:
    """Make a robot that writes down what it is told, before anything else."""
    made = ScriptedRobot(
        host,
        Resource(name="param/label", description="A text.", value=str),
        Resource(name="service/run", description="Runs.", input=str, output=str),
    )
    if host.tenant == "beta":
        names = [f"service/s{number}" for number in range(SCOPES)]
        made.add(*(Resource(name=name, description="Is leased.") for name in names))

    async def take(value: Any) -> None:
        ran.write(value)

    async def run(value: Any, _progress: Progress) -> Any:
        ran.write(value)
        await asyncio.sleep(random.choice((0, 0, 0.002)))
        return value[::-1]

    made.takes["param/label"] = take
    made.behaviours["service/run"] = run
    return made


def prepared(folder: Path) -> Prepared:
    @asynccontextmanager
    async def open_robot(_config: NoOptions, host: Host) -> AsyncGenerator[ScriptedRobot]:
        yield robot(host, Journal(folder / "ran"))

    plugins: Any = SimpleNamespace(
        backends={"robot": BackendKind("robot", NoOptions, open_robot)},
        transports={},
        adapters={},
        missing=[],
        points={"plugins": {}},
        is_missing=lambda _group, _name: None,
    )
    config = parse(CONFIG + table("store", path=folder / "store.db"), "crash")
    kinds = [*rcp_audit.rcp_features(), *rcp_leases.rcp_features()]
    features = active(config, {kind.name: kind for kind in kinds}, "crash")
    return Prepared(config, plugins, tuple(NoOptions() for _ in config.backends), {}, {}, features)


class Client:
    """Has a number of requests in flight for as long as it lives."""

    def __init__(self, server: Server, told: Journal, sent: Journal, work: Iterator[Sent]) -> None:
        self._told, self._sent, self._work = told, sent, work
        principal = server.client_api.authenticate("operator-operator")
        self.connection = server.client_api.connect(principal, Encoding.JSON, self._flush)

    def greet(self, hello: dict[str, Any]) -> None:
        """Come back to a session, or begin one, with a subscription in it."""
        for envelope in (
            {"type": "hello", "id": "hello", "body": hello},
            {"type": "subscribe", "id": "label", "path": "/param/label"},
        ):
            self.connection.receive(json.dumps(envelope).encode())

    def send(self, count: int) -> None:
        for id_, envelope in itertools.islice(self._work, count):
            self._sent.write([id_, envelope])
            self.connection.receive(json.dumps({"id": id_, **envelope}).encode())

    def _flush(self) -> None:
        ended = 0
        for data in self.connection.outbox.collect():
            reply = json.loads(data)
            if reply["type"] != "update":
                self._told.write(reply)
            ended += reply["type"] in ("write", "execute") and reply["status"] in FINAL
        self.send(ended)


class Guard:
    """Looks at leases and latches, then changes them, one request after the other."""

    def __init__(self, server: Server, journal: Journal, life: int) -> None:
        self._journal = journal
        self._steps = self._plan(life)
        principal = server.client_api.authenticate("admin-admin-admin")
        self.connection = server.client_api.connect(principal, Encoding.JSON, self._flush)
        self._next(None)

    def _plan(self, life: int) -> Generator[dict[str, Any], dict[str, Any]]:
        yield {"type": "read", "path": "/system/estop"}
        yield {"type": "read", "path": "/system/leases"}
        for number in itertools.count():
            scope = f"/tenant/beta/service/s{random.randrange(SCOPES)}"
            if number < 2:
                told = yield leasing(do="acquire", scope=scope, ttl=TTL)
                if told["status"] == "completed" and random.random() < 0.3:
                    yield leasing(do="release", lease=told["body"]["lease"])
            stop = {"scope": "/tenant/gamma", "reset": random.random() < 0.5}
            body = {**stop, "reason": f"{life}-{number}"}
            yield {"type": "execute", "path": "/system/estop", "body": body}

    def _next(self, told: Any) -> None:
        envelope = self._steps.send(told)
        self._journal.write({"sent": envelope})
        self.connection.receive(json.dumps({"id": "g", **envelope}).encode())

    def _flush(self) -> None:
        for data in self.connection.outbox.collect():
            reply = json.loads(data)
            if reply.get("status") in FINAL:
                self._journal.write({"told": reply})
                asyncio.get_running_loop().call_soon(self._next, reply)


def leasing(**body: Any) -> dict[str, Any]:
    return {"type": "execute", "path": "/system/leases", "body": body}


def load(life: int, client: int) -> Iterator[Sent]:
    """Make requests of every kind; each one's mark is its id, its key and its value."""
    for number in itertools.count():
        mark = f"{life}-{client}-{number}"
        if client == 0 and number < 5:
            yield f"d{mark}", {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
        elif number % 5 == 4:
            yield f"u{mark}", {"type": "write", "path": "/param/label", "body": f"u{mark}"}
        elif number % 2:
            yield f"w{mark}", keyed({"type": "write", "path": "/param/label"}, f"w{mark}")
        else:
            yield f"e{mark}", keyed({"type": "execute", "path": "/service/run"}, f"e{mark}")


def keyed(envelope: dict[str, Any], mark: str) -> dict[str, Any]:
    return {**envelope, "body": mark, "idempotency_key": mark}


def live(folder: Path, life: int, again: list[Sent], hello: dict[str, Any], ready: int) -> None:
    """Be a gateway until killed."""
    configure("error", "json")

    async def serve() -> None:
        async with running(prepared(folder), Recent()) as server:
            os.write(ready, b".")
            told, sent = Journal(folder / f"told-{life}"), Journal(folder / f"sent-{life}")
            repeats = iter([(f"again-{mark}", envelope) for mark, envelope in again])
            Client(server, told, sent, repeats).send(len(again))
            Guard(server, Journal(folder / f"guard-{life}"), life)
            for number in range(3):
                client = Client(server, told, sent, load(life, number))
                if number == 0:
                    client.greet(hello)
                client.send(IN_FLIGHT)
            await asyncio.Event().wait()

    asyncio.run(serve())


class Inspector:
    """Knows what has been promised so far."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._outcomes: dict[str, Any] = {}
        self._seen = 0
        self._records: dict[tuple[str, str], Any] = {}
        self.counts: Counter[str] = Counter()
        self.keys: list[Sent] = []
        self._ran: Counter[str] = Counter()
        self._looked = 0
        self.hello: dict[str, Any] = {}
        """How a client comes back to its session."""
        self._latched: bool | None = None
        self._leases: dict[str, dict[str, Any]] = {}

    def inspect(self, life: int) -> None:
        """Look at everything after a kill; raises AssertionError with what is wrong."""
        before = self._ran.copy()
        ran = self._folder / "ran"
        now = Counter(lines(ran, self._looked))
        self._ran += now
        self._looked = ran.stat().st_size if ran.exists() else 0
        twice = [mark for mark, count in self._ran.items() if count > 1]
        assert not twice, f"ran twice: {[self._evidence(one, life, now[one]) for one in twice]}"
        store = self._folder / "store.db"
        if not store.exists():
            return
        assert find_damage(store) is None
        if life % 4 == 3:  # the whole chain, those of the lives before included
            verdict = examined(store)
            assert not verdict.findings, verdict.findings
        self._read(store)
        for reply in lines(self._folder / f"told-{life}"):
            if reply["type"] in ("hello", "subscribe", "notice"):
                self._greeted(reply)
            else:
                self._check(reply, before)
        sent: dict[str, Any] = {}
        for fact in lines(self._folder / f"guard-{life}"):
            if "sent" in fact:
                sent = fact["sent"]
                self._begun(sent)
            else:
                self._guarded(sent, fact["told"])
        self._see_latch_file(store)
        for id_, envelope in lines(self._folder / f"sent-{life}"):
            if "idempotency_key" in envelope and not id_.startswith("again-"):
                self.keys.append((id_, envelope))
        self.counts["records"] = self._seen
        self.counts["ran"] = sum(self._ran.values())

    def _evidence(self, mark: str, life: int, now: int) -> dict[str, Any]:
        """Tell what is known of a mark: the files are gone when somebody reads of it."""
        files = sorted(self._folder.glob("told-*"))
        told = [(one.name, fact) for one in files for fact in lines(one) if mark in str(fact)]
        with closing(open_read_only(self._folder / "store.db")) as base:
            rows = [
                (record, data)
                for record, data in base.execute("SELECT seq, record FROM audit")
                if mark.encode() in data
            ]
        beside = sorted(one.name for one in self._folder.glob("store.db*"))
        return {"mark": mark, "life": life, "now": now, "told": told, "rows": rows, "files": beside}

    def _see_latch_file(self, store: Path) -> None:
        """It is whole after each kill, and by itself enough to know what is latched."""
        kept = LatchFile(store).read()
        if kept is None:
            assert not self.counts["told"], "it was there once"  # else killed before the first one
            return
        if self._latched is not None:
            assert ("/tenant/gamma" in kept) == self._latched, kept
            self.counts["latches beside" if self._latched else "resets beside"] += 1

    def _read(self, store: Path) -> None:
        with closing(open_read_only(store)) as base:
            rows = base.execute("SELECT record FROM audit WHERE seq > ?", (self._seen,))
            for (data,) in rows:
                record = json.loads(data)
                self._seen = record["seq"]
                name = record.get("command") or record.get("id")
                if record["what"] == "estop":
                    name = record["reason"]
                elif record["what"] == "lease":
                    name = f"{record['did']} {record['lease']}"
                if name is not None:
                    self._records[record["what"], name] = record

    def _check(self, reply: dict[str, Any], before: Counter[str]) -> None:
        id_, status = reply["id"], reply["status"]
        self.counts["told"] += 1
        if reply["type"] == "execute" and "command" in reply:
            assert ("execute", reply["command"]) in self._records, reply
            if status in FINAL and not id_.startswith("again-"):
                expected = reply["error"]["code"] if "error" in reply else "ok"
                assert self._records["command", reply["command"]]["outcome"] == expected, reply
        elif id_[0] == "d":
            assert reply["error"]["code"] == "forbidden", reply
            assert ("denial", id_) in self._records, reply
            self.counts["denials"] += 1
        elif id_[0] in "uw":
            assert self._records["write", id_]["outcome"] == "ok", reply
        if status not in FINAL:
            return
        mark = id_.removeprefix("again-")
        error = reply.get("error", {}).get("code")
        outcome = (status, reply.get("body"), reply.get("command"), error)
        if mark in self._outcomes:
            assert self._outcomes[mark] == outcome, (reply, self._outcomes[mark])
            self.counts["repeated"] += 1
        elif id_ != mark and before[mark]:
            assert error == "internal" or status == "completed", reply
            self.counts["cut off" if error else "ended unheard"] += 1
        elif id_ != mark and error is not None:
            assert error == "internal", reply
            self.counts["not begun"] += 1
        self._outcomes[mark] = outcome

    def _begun(self, sent: dict[str, Any]) -> None:
        """Until it is answered, what a request does may have come about or not."""
        body = sent.get("body", {})
        if sent["path"] == "/system/estop" and body:
            self._latched = None
        elif body.get("do") == "release":
            self._leases.pop(body["lease"], None)

    def _guarded(self, sent: dict[str, Any], reply: dict[str, Any]) -> None:
        body = sent.get("body")
        if sent["path"] == "/system/estop":
            assert reply["status"] == "completed", reply
            latched = "/tenant/gamma" in reply["body"]["scopes"]
            if body is not None:
                assert latched != body["reset"], reply
                if "not written yet" in reply.get("message", ""):
                    self.counts["unrecorded"] += 1  # a stop does not wait for a slow disk
                    return
                assert ("estop", body["reason"]) in self._records, reply
            elif self._latched is not None:
                assert latched == self._latched, reply
                self.counts["latches back" if latched else "resets back"] += 1
            self._latched = latched
        elif body is None:
            held = {lease["lease"]: lease for lease in reply["body"]}
            for id_, lease in self._leases.items():
                if lease["expires"] > reply["timestamp"]:
                    found = held[id_]  # a renewal that nobody was told of may have made it longer
                    assert found | {"expires": lease["expires"]} == lease, (lease, reply)
                    assert found["expires"] >= lease["expires"], (lease, reply)
                    self.counts["leases back"] += 1
            self._leases = held
        elif reply["status"] == "completed":
            did, lease = body["do"], reply["body"]
            assert ("lease", f"{did} {lease['lease']}") in self._records, reply
            if did == "acquire":
                self._leases[lease["lease"]] = lease
        else:
            assert reply["error"]["code"] == "lease_held", reply
            self.counts["leases in the way"] += 1

    def _greeted(self, reply: dict[str, Any]) -> None:
        if reply["type"] == "notice":
            assert (reply["code"], reply.get("reason")) == ("gap", "restart"), reply
            self.counts["subscriptions restored"] += 1
        elif reply["type"] == "hello" and reply["status"] == "completed":
            body = reply["body"]
            if self.hello:
                assert body["session"] == self.hello["session"], reply
                self.counts["sessions resumed"] += 1
            self.hello = {name: body[name] for name in ("session", "resume_token")}
        elif reply["type"] == "hello":
            assert reply["error"]["code"] == "gap", reply
            self.counts["sessions lost"] += 1
            self.hello = {}

    def again(self) -> list[Sent]:
        """Choose keys to send again: the latest, and some of any age that the gateway remembers."""
        known = self.keys[-KNOWN:]
        older = random.sample(known, min(10, len(known)))
        chosen = dict([*older, *self.keys[-AGAIN:]])
        return list(chosen.items())


def main(folder: Path, lives: int, seed: int) -> None:
    random.seed(seed)
    inspector = Inspector(folder)
    span = SHORTEST
    for life in range(lives):
        told, ready = os.pipe()
        pid = os.fork()
        if pid == 0:
            random.seed(seed + life)
            try:
                live(folder, life, inspector.again(), inspector.hello, ready)
            finally:
                os._exit(1)
        os.close(ready)
        if life % 4:  # else killed while it starts, perhaps
            os.read(told, 1)
        wait(random.uniform(0, span))
        os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        os.close(told)
        assert os.WIFSIGNALED(status), f"life {life} ended by itself"
        before = inspector.counts["told"]
        inspector.inspect(life)
        if life % 4:  # where a commit takes long, a life has to be longer to see replies
            heard = inspector.counts["told"] - before
            span = max(span / 2, SHORTEST) if heard >= ENOUGH else min(span * 1.5, LONGEST)
    print(json.dumps(inspector.counts))  # noqa: T201 - the test reads it


def wait(seconds: float) -> None:
    """Let the child live for a while: the moment of its end is to be any."""
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-6))
    signal.sigwait((signal.SIGALRM,))


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGALRM,))
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
