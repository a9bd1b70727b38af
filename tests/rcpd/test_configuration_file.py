"""The configuration file after its gateway ended between any two steps of a roll-out."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from rcp_kernel.features.configuration import Phase
from rcpd.configuration_file import ConfigurationFile, Proposal

OLD, NEW = b"name = 'old'\n", b"name = 'new'\n"


def _proposal(phase: Phase = "probation", seconds: float = 60.0) -> Proposal:
    return Proposal(
        phase=phase,
        digest=hashlib.sha256(NEW).hexdigest(),
        by="ann",
        via="h1",
        since=1,
        seconds=seconds,
        restart=phase == "restarting",
        down=(),
    )


def _begun(folder: Path, proposal: Proposal) -> Path:
    path = folder / "rcp.toml"
    path.write_bytes(OLD)
    path.chmod(0o640)
    ConfigurationFile(path).begin(NEW, proposal)
    assert path.read_bytes() == NEW
    assert path.stat().st_mode & 0o777 == 0o640
    return path


def _started(path: Path) -> ConfigurationFile:
    file = ConfigurationFile(path)
    file.start()
    return file


def _phase(file: ConfigurationFile) -> Phase | None:
    return file.proposal and file.proposal.phase


def test_the_next_start_rolls_back(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal())
    assert _phase(_started(path)) == "rolled_back"
    assert path.read_bytes() == OLD
    assert path.stat().st_mode & 0o777 == 0o640


def test_one_restart_is_expected_and_the_next_start_rolls_back(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal("restarting"))
    file = _started(path)
    file.serves()
    assert (path.read_bytes(), file.on_probation) == (NEW, True)
    assert _phase(_started(path)) == "rolled_back"
    assert path.read_bytes() == OLD


def test_a_confirmed_file_stays(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal())
    ConfigurationFile(path).enter("confirmed")
    assert _phase(_started(path)) == "confirmed"
    assert path.read_bytes() == NEW


@pytest.mark.parametrize("content", [OLD, b"name = 'by hand'\n"])
def test_a_file_that_is_not_the_proposed_one_is_left_alone(tmp_path: Path, content: bytes) -> None:
    path = _begun(tmp_path, _proposal())
    path.write_bytes(content)  # not yet written, or edited meanwhile
    file = _started(path)
    assert (path.read_bytes(), file.on_probation) == (content, False)


def test_a_marker_that_cannot_be_read_changes_nothing(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal())
    (tmp_path / "rcp.toml.roll-out").write_text("{")
    assert not _started(path).on_probation
    assert path.read_bytes() == NEW


def test_the_link_to_a_file_stays_a_link(tmp_path: Path) -> None:
    real = _begun(tmp_path, _proposal())
    link = tmp_path / "link.toml"
    link.symlink_to(real)
    _started(link)
    assert link.is_symlink()
    assert real.read_bytes() == OLD


def test_a_gateway_that_never_serves_is_started_again_with_the_file_before(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal("restarting", 0.1))
    program = (
        "import sys, time, pathlib; from rcpd.configuration_file import ConfigurationFile\n"
        "file = ConfigurationFile(pathlib.Path(sys.argv[1])); file.start()\n"
        "time.sleep(300 if file.on_probation else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, path],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "the gateway did not start in time" in done.stderr
    assert path.read_bytes() == OLD


def test_a_full_disk_does_not_keep_the_file_before_out(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal("restarting"))
    for name in ("rcp.toml.new", "rcp.toml.roll-out.new"):  # nothing can be written
        (tmp_path / name / "x").mkdir(parents=True)
    file = _started(path)
    assert (path.read_bytes(), _phase(file)) == (OLD, "rolled_back")
    assert path.stat().st_mode & 0o777 == 0o640
    assert _phase(_started(path)) == "rolled_back"
    assert path.read_bytes() == OLD


def test_a_roll_back_that_fails_does_not_end_the_gateway(tmp_path: Path) -> None:
    path = _begun(tmp_path, _proposal())
    (tmp_path / "rcp.toml.before").unlink()
    file = _started(path)
    assert (path.read_bytes(), file.on_probation) == (NEW, True)
    assert not file.fails()


def test_a_restart_does_not_wait_for_a_gateway_that_hangs_as_it_closes(tmp_path: Path) -> None:
    program = (
        "import sys, time, pathlib; from rcpd.configuration_file import ConfigurationFile\n"
        "mark = pathlib.Path(sys.argv[1])\n"
        "if mark.exists(): sys.exit(5)\n"
        "mark.touch(); ConfigurationFile(mark).restart(0.1)\n"
        "time.sleep(300)"
    )
    command = [sys.executable, "-c", program, tmp_path / "mark"]
    assert subprocess.run(command, timeout=120, check=False).returncode == 5
