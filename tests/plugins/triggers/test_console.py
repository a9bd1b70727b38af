"""`rcpctl triggers` and `rcpctl alarms`, as a person types them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from configuration import table
from durability.process import ADMIN, CONFIG, Served, until

RCPCTL = Path(sys.executable).with_name("rcpctl")
BOUND = 60.0  # s


def test_triggers_are_added_tested_listed_and_acknowledged(tmp_path: Path) -> None:
    life = Served(tmp_path, tmp_path / "store.db", CONFIG + table("features.triggers"))

    def rcpctl(*words: str, code: int = 0) -> str:
        done = subprocess.run(
            [RCPCTL, "--url", life.url, "--token", ADMIN, *words],
            capture_output=True,
            text=True,
            timeout=BOUND,
            check=False,
        )
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    try:
        spec = ["--robot", "/tenant/alpha", "--when", "param.speed_limit > 1.0", "--alarm"]
        dock = ["--execute", "/action/no_such_action"]
        assert "does not exist" in rcpctl("triggers", "add", "fast", *spec, *dock, code=3)
        rcpctl("triggers", "add", "fast", *spec, "--message", "Too fast", "--repeat", "60")
        (robot,) = json.loads(rcpctl("triggers", "test", "fast"))["robots"]
        assert (robot["condition"], robot["would"]) == ("false", ["raise an alarm"])
        life.ask("PUT", "/tenant/alpha/param/speed_limit", 1.5)
        until(lambda: bool(life.ask("GET", "/system/alarms")["body"]))
        (trigger,) = [json.loads(line) for line in rcpctl("triggers").splitlines()]
        assert (trigger["by"], trigger["robots"][0]["state"]) == ("admin", "active")
        shown = rcpctl("alarms", "--text")
        id_ = life.ask("GET", "/system/alarms")["body"][0]["alarm"]
        assert id_ in shown
        assert "Too fast" in shown
        assert "acknowledged" in rcpctl("alarms", "ack", id_, "--comment", "slowed down", "--text")
        assert life.ask("GET", "/system/alarms")["body"][0]["comment"] == "slowed down"
        rcpctl("triggers", "remove", "fast")
        assert life.ask("GET", "/system/triggers")["body"] == []
    finally:
        life.kill()
