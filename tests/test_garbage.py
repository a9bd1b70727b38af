"""What is set aside from garbage collections and becomes garbage later is told of, at the end."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
INI = f"""
[pytest]
addopts = --import-mode=importlib -p no:cacheprovider
pythonpath = {TESTS}
filterwarnings = error
"""
CONFTEST = f"""
import importlib.util, sys
spec = importlib.util.spec_from_file_location("shared", {str(TESTS / "conftest.py")!r})
shared = importlib.util.module_from_spec(spec)
spec.loader.exec_module(shared)
globals().update({{k: v for k, v in vars(shared).items() if k.startswith("garbage_")}})
"""
KEEPS = """
import socket, sys
class Peer: pass
def test_a_peer_of_itself_is_kept():
    peer = sys.kept = Peer()
    peer.peer, peer.socket = peer, socket.socket()
"""
FORGETS = """
import sys
def test_it_is_forgotten(): del sys.kept
"""


def test_what_files_leave_behind_for_others_to_forget_is_looked_at_once(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text(INI)
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_a.py").write_text(KEEPS)
    (tmp_path / "test_b.py").write_text(FORGETS)
    done = subprocess.run(
        [sys.executable, "-m", "pytest"],
        cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "RCP_"))}
        | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
    )
    assert "2 passed, 1 error" in done.stdout, done.stdout
    assert "ResourceWarning: unclosed <socket" in done.stdout
