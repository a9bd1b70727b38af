"""Run a hub and three robots with gateways of their own, each in a process: `make fleet`.

The robots dial the hub's router; their gateways listen nowhere. Ctrl-C ends all.
"""

from __future__ import annotations

import argparse
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

HERE = Path(__file__).parent
ROBOTS = {"r1": "rover", "r2": "rover", "d1": "drone"}
"""Configuration files by the robots' ids."""
_WORDS = """\
One hub on http://127.0.0.1:{port} and three robots behind it; their logs are in {folder}.

    export RCP_URL=http://127.0.0.1:{port} RCP_TOKEN={operator}
    .venv/bin/rcpctl robots
    .venv/bin/rcpctl fleet
    .venv/bin/rcpctl watch /sensor/r1/pose --rate 2 --count 4
    .venv/bin/rcpctl execute /action/r1/move_to '{{"position": {{"x": 2, "y": 1, "z": 0}}}}'
    .venv/bin/rcpctl execute /action/d1/arm
    .venv/bin/rcpctl estop

Ctrl-C ends all of it."""
_STOP = 15.0  # s for a process to end after a request to


def make_keys(folder: Path) -> None:
    """Make the key with which the hub signs whom it has authenticated, and its public half."""
    key = Ed25519PrivateKey.generate()
    private = folder / "hub.key"
    private.touch(mode=0o600)
    private.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    (folder / "hub.pub").write_bytes(
        key.public_key().public_bytes(
            serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
        )
    )


@contextmanager
def serving(
    name: str, config: Path, environment: dict[str, str]
) -> Generator[subprocess.Popen[bytes]]:
    """Run one gateway while entered; what it logs goes to a file."""
    folder = Path(environment["FLEET"])
    rcpd = shutil.which("rcpd", path=str(Path(sys.executable).parent)) or "rcpd"
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(  # noqa: S603 - our own command
            [rcpd, "serve", str(config)], env=environment, stdout=log, stderr=log
        )
        try:
            yield process
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(_STOP)
            process.kill()


def configured(folder: Path, kind: str, port: int, router: int) -> Path:
    """Write a configuration with the ports of this run."""
    text = (HERE / f"{kind}.toml").read_text()
    made = folder / f"{kind}.toml"
    made.write_text(text.replace("port = 8080", f"port = {port}").replace(":7447", f":{router}"))
    return made


def main() -> int:
    """Serve until one of them ends, or Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8080, help="of the hub")
    parser.add_argument("--router", type=int, default=7447, help="port that the robots dial")
    options = parser.parse_args()
    ports = options.port, options.router
    operator = secrets.token_urlsafe(24)
    with tempfile.TemporaryDirectory(prefix="rcp-fleet-") as name, ExitStack() as stack:
        folder = Path(name)
        make_keys(folder)
        environment = os.environ | {"FLEET": name, "OPERATOR_KEY": operator}
        hub = serving("hub", configured(folder, "hub", *ports), environment)
        processes = {"hub": stack.enter_context(hub)}
        for robot, kind in ROBOTS.items():
            own = environment | {"ROBOT": robot}
            served = serving(robot, configured(folder, kind, *ports), own)
            processes[robot] = stack.enter_context(served)
        print(_WORDS.format(port=options.port, folder=folder, operator=operator), flush=True)
        with suppress(KeyboardInterrupt):
            while not (ended := [one for one, p in processes.items() if p.poll() is not None]):
                time.sleep(0.2)
            print((folder / f"{ended[0]}.log").read_text(), file=sys.stderr)
            print(f"{ended[0]} has ended; what it logged is above.", file=sys.stderr)
            return 1
        return 0


if __name__ == "__main__":
    sys.exit(main())
