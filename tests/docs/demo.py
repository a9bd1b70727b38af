"""A demo that runs for the tests of what the documentation shows."""

from __future__ import annotations

import os
import re
import selectors
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

BIN = Path(sys.executable).parent
_START = 180.0  # s


@dataclass(frozen=True)
class Demo:
    """Where it runs, the keys of the operator and the admin, and the process."""

    url: str
    key: str
    admin: str
    banner: str
    environment: dict[str, str]
    process: subprocess.Popen[bytes]


@contextmanager
def demo(runtime: Path, port: int = 0, programs: Path = BIN) -> Generator[Demo]:
    """Run `rcpd demo` while entered, on a free port if none is given.

    `runtime` is where it leaves its key, `programs` the folder of the `rcpd` that is run.
    """
    environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime), "PYTHONUNBUFFERED": "1"}
    for name in ("RCP_URL", "RCP_TOKEN", "RCP_TENANT"):
        environment.pop(name, None)
    command = [str(programs / "rcpd"), "demo", "--port", str(port)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment
    ) as process:
        try:
            banner = _until(process, "Ready.")
            url = re.search(r"http://[\w.:]+", banner)
            key = re.search(r"rcp_op_[\w-]+", banner)
            assert url is not None, banner
            admin = re.search(r"rcp_ad_[\w-]+", banner)
            assert key is not None, banner
            assert admin is not None, banner
            yield Demo(url[0], key[0], admin[0], banner, environment, process)
        finally:
            process.terminate()
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()


def rcpctl(live: Demo, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `rcpctl` at a demo, with the operator's key."""
    return subprocess.run(
        [str(BIN / "rcpctl"), "--url", live.url, "--token", live.key, *arguments],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
        env=live.environment,
    )


def _until(process: subprocess.Popen[bytes], word: str) -> str:
    assert process.stdout is not None
    out = b""
    end = time.monotonic() + _START
    with selectors.DefaultSelector() as ready:
        ready.register(process.stdout, selectors.EVENT_READ)
        while word.encode() not in out:
            assert ready.select(max(0.0, end - time.monotonic())), f"no {word!r} in {out.decode()}"
            chunk = os.read(process.stdout.fileno(), 65536)
            assert chunk, f"the demo ended: {out.decode()}"
            out += chunk
    return out.decode()
