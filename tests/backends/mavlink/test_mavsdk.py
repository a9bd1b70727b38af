"""MAVSDK, a client of others, flies the twin unchanged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from backends.mavlink.twins import twin_process

FLIGHTS = Path(__file__).with_name("mavsdk_flights.py")
BOUND = 150  # s, more than the bound that a flight has for itself
TOLD = 3000  # characters of what it said last


@pytest.mark.parametrize(
    "flight",
    [
        "arms_takes_off_goes_returns_and_lands",
        "reads_and_sets_parameters",
        "uploads_a_mission_and_reads_it_back",
        "flies_a_mission_and_downloads_its_log",
        "keeps_files_and_fences",
        "is_flown_by_hand",
        "finds_and_turns_the_gimbal",
    ],
)
def test_mavsdk(flight: str, tmp_path: Path) -> None:
    with twin_process("udpin:127.0.0.1:0", options=("--speed", "8", "--warmup", "20")) as twin:
        done = subprocess.run(
            [sys.executable, "-W", "error", FLIGHTS, flight, str(twin.ports["udpin"]), tmp_path],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=BOUND,
            check=False,
        )
    assert done.returncode == 0, done.stdout[-TOLD:]
