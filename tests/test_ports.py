"""A port that a test will need is its own, whoever else takes ports meanwhile."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from ports import free_port

_ASKS = "from ports import free_port; print(*(free_port() for _ in range(50)))"
_GIVEN = Path("/proc/sys/net/ipv4/ip_local_port_range")


def test_no_port_is_given_twice_to_whatever_process() -> None:
    mine = [free_port() for _ in range(50)]
    others = [
        subprocess.run(
            [sys.executable, "-c", _ASKS],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        ).stdout.split()
        for _ in range(2)
    ]
    assert len({*mine, *map(int, others[0])}) == 100
    assert len({*mine, *map(int, others[1])}) == 100


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_port_that_somebody_has_is_not_given(kind: int, monkeypatch: pytest.MonkeyPatch) -> None:
    free = free_port(kind)
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        monkeypatch.setattr(
            "ports._PORTS", range(taken.getsockname()[1], taken.getsockname()[1] + 1)
        )
        with pytest.raises(AssertionError, match="in use"):
            free_port(kind)
    with socket.socket(socket.AF_INET, kind) as here:
        here.bind(("127.0.0.1", free))


def test_the_system_gives_none_of_them_to_a_socket_by_itself() -> None:
    first, last = map(int, _GIVEN.read_text(encoding="ascii").split())
    assert not first <= free_port() <= last
