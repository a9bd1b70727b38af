"""A client that comes back to its session is answered, whoever was killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

CYCLES = 24  # as many as bring it out, if reading is continued only by its own event


def test_who_comes_back_is_answered_however_often_the_gateway_or_client_is_killed(
    tmp_path: Path,
) -> None:
    """Replies missed are told again all at once, while the first requests are handled."""
    script = Path(__file__).with_name("resumes.py")
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path), str(CYCLES), "1"],
        env={**os.environ, "PYTHONPATH": str(script.parents[1])},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    counts = json.loads(done.stdout)
    assert "deaf" not in counts, done.stderr[-4000:]
    assert counts["resumed"] >= CYCLES // 2  # what it is about did happen
