"""Freed memory stays: a large buffer is not fetched from the system again and again."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import resource
from rcpd.memory import keep_freed_memory
keep_freed_memory()
bytes(4_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    bytes([1]) * 4_000_000
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_a_buffer_that_was_freed_is_used_again() -> None:
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=120
    )
    assert int(run.stdout) < 5000  # 50 buffers have 50 000 pages
