"""What has a key runs once at most, wherever on its way the gateway is killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

DONE, CUT_OFF = ["completed", None], ["failed", "internal"]
ANEW = {"ran": 1, "told": [None, DONE, DONE]}
NOT_BEGUN = {"ran": 0, "told": [None, CUT_OFF, CUT_OFF]}
UNKNOWN = {"ran": 1, "told": [None, CUT_OFF, CUT_OFF]}
KNOWN = {"ran": 1, "told": [None, DONE, DONE]}
TOLD = {"ran": 1, "told": [DONE, DONE, DONE]}
EXPECTED = {
    "before the key is noted": ANEW,
    "when the key is noted": ANEW,
    "before the key is handed over": ANEW,
    "before the key is committed": ANEW,
    "when the key is committed": NOT_BEGUN,
    "before the gateway hears of it": NOT_BEGUN,
    "before the robot is told": NOT_BEGUN,
    "when the robot is told": UNKNOWN,
    "before the outcome is noted": UNKNOWN,
    "when the outcome is noted": UNKNOWN,
    "before the outcome is handed over": UNKNOWN,
    "before the outcome is committed": UNKNOWN,
    "when the outcome is committed": KNOWN,
    "before the gateway hears of that": KNOWN,
    "before the client is told": KNOWN,
    "when the client is told": TOLD,
}
"""How often the robot ran it in all, and what each of three lives answered; the first was killed there."""


@pytest.mark.parametrize("kind", ["write", "execute"])
def test_it_runs_once_at_most_wherever_the_gateway_is_killed(kind: str, tmp_path: Path) -> None:
    script = Path(__file__).with_name("keys.py")
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path), kind],
        env={**os.environ, "PYTHONPATH": str(script.parents[1])},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert json.loads(done.stdout) == EXPECTED
