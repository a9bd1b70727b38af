"""The dashboard left open: for a moment what `benchmarks/dashboard.py --seconds 1800` watches for long."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from browser.watched import require_pages

pytestmark = pytest.mark.serial
SCRIPT = Path(__file__).parents[2] / "benchmarks" / "dashboard.py"


@pytest.fixture(scope="module")
def found(chromium: str) -> dict[str, Any]:
    """Measure once for all tests of this file."""
    require_pages()
    done = subprocess.run(
        [sys.executable, SCRIPT, "--seconds", "10", "--chromium", chromium, "--json"],
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_pages_are_drawn_all_the_time(found: dict[str, Any]) -> None:
    # How fast is the benchmark's to say: here the machine has other things to do.
    assert min(found["frames"].values()) > 5, found
    assert max(found["longest"].values()) < 3000, found


def test_neither_pages_nor_gateway_grow(found: dict[str, Any]) -> None:
    for name, (begun, ended) in found["heap"].items():
        assert ended < begun + 4, f"{name}: {begun} → {ended} MB"
    begun, ended = found["rss"]
    assert ended < begun + 15, found


def test_the_gateway_has_next_to_nothing_to_do(found: dict[str, Any]) -> None:
    assert found["cpu"]["with"] < 60, found
