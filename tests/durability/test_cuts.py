"""What a hub asks of a robot happens once and is answered once, whatever happens to the link."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

CUTS, PAIRS = 200, 8


def test_every_command_ends_once_and_runs_once_however_often_the_link_is_cut() -> None:
    script = Path(__file__).with_name("cuts.py")
    done = subprocess.run(
        [sys.executable, str(script), str(CUTS), "1", str(PAIRS)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    counts = json.loads(done.stdout)
    assert sum(counts[kind] for kind in ("cut", "parted", "frozen", "reordered", "slowed")) == CUTS
    assert counts["links"] > 2  # what it is about did happen
    assert counts["action/r7/go completed"]
    assert counts["plan completed"]
    assert counts["under a lease"]
    assert counts["hub's lease acquire completed"]
    assert counts["hub's lease acquire lease_held"]
    assert counts["robot's lease"]
