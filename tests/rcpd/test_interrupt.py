"""Ctrl-C while plugins are imported ends `rcpd serve`: nothing moves yet."""

from __future__ import annotations

import signal
import subprocess
import sys

_IMPORTING = """
import signal
from rcp_kernel.config.file import parse
from rcpd import serve

def prepare(*_):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        print("the plugin has taken it")

signal.signal(signal.SIGINT, signal.default_int_handler)
serve.prepare = prepare
serve.run(parse("", "rcp.toml"), "rcp.toml", None, None)
"""


def test_an_interrupt_while_a_plugin_is_imported_is_not_lost() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _IMPORTING], capture_output=True, timeout=60, check=False
    )
    assert done.returncode == -signal.SIGINT
    assert done.stdout == b""
