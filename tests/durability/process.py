"""A real `rcpd serve` with a store, that can be killed, and a client of it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from configuration import backend, key, listener, table

RCPD = Path(sys.executable).with_name("rcpd")
BOUND = 60.0  # s any wait of a test may take, on a machine that is busy otherwise
ADMIN = "admin-admin-admin"
CONFIG = listener() + backend("rover", use="sim") + key("admin", ADMIN)


class Served:
    """One life of a gateway."""

    def __init__(self, folder: Path, store: Path, text: str = CONFIG) -> None:
        self.config = folder / "rcp.toml"
        self.config.write_text(text + table("store", path=store))
        self.said = folder / f"stderr-{time.monotonic_ns()}"
        with self.said.open("w") as stderr:
            self._process = subprocess.Popen([RCPD, "serve", self.config], stderr=stderr)
        try:
            until(lambda: "serving on " in self.text or self._process.poll() is not None)
        except AssertionError:  # nobody else knows of it
            self.kill()
            raise
        assert "serving on " in self.text, self.text
        self.url = self.text.partition("serving on ")[2].split()[0]

    @property
    def text(self) -> str:
        """What it has said."""
        return self.said.read_text()

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    def ask(self, method: str, path: str, body: Any = None) -> dict[str, Any]:
        """Read (GET), write (PUT) or execute (POST); return the reply's envelope."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"{self.url}/rcp/v1/context{path}", data, method=method)
        request.add_header("Authorization", f"Bearer {ADMIN}")
        request.add_header("Content-Type", "application/json")
        try:
            with urllib.request.urlopen(request, timeout=BOUND) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            return json.load(error)

    def status(self) -> dict[str, Any]:
        """Return the health report."""
        return self.ask("GET", "/system/status")["body"]

    def latched(self) -> bool:
        """Tell whether the rover is under an e-stop."""
        return "rover" in self.ask("GET", "/system/estop")["body"]["robots"]

    def estop(self, **body: Any) -> dict[str, Any]:
        """Press or reset the e-stop."""
        return self.ask("POST", "/system/estop", body)

    def kill(self) -> None:
        """End it as a crash does."""
        self._process.kill()
        self._process.wait(BOUND)

    def end(self) -> int:
        """End it in an orderly way; return the exit code."""
        self._process.terminate()
        return self._process.wait(BOUND)


def until(happened: Callable[[], object]) -> None:
    """Wait for what another process does."""
    end = time.monotonic() + BOUND
    while not happened():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)
