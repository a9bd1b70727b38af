"""A real `rcpd` in a process of its own, for tests that need no more than its address."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from configuration import backend, key, listener

__all__ = ["ROVER", "serving"]

ROVER = (
    listener()
    + backend("rover", use="sim")
    + key("operator", "operator-operator")
    + key("admin", "admin-admin-admin")
)
"""A simulated rover in tenant alpha, an operator and an admin: whoever serves it adds the rest."""
_CLOSE = 40.0  # s that it may take to end


@contextmanager
def serving(config: Path, text: str) -> Generator[str]:
    """Serve a configuration, written to a file, while entered; yield the address."""
    config.write_text(text)
    rcpd = Path(sys.executable).with_name("rcpd")
    with subprocess.Popen([rcpd, "serve", config], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        received: list[str] = []
        for line in process.stderr:
            received.append(line)
            if "serving on " in line:
                break
        else:
            raise AssertionError("rcpd did not serve: " + "".join(received))
        # A pipe that nobody empties would stop the gateway at its next lines of log.
        reading = threading.Thread(target=process.stderr.read, daemon=True)
        reading.start()
        try:
            yield line.rpartition(" ")[2].strip()
        finally:
            process.terminate()
            process.wait(timeout=_CLOSE)
            reading.join(_CLOSE)
