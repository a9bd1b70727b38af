"""Standard output while it is read: what nobody takes comes out, whatever a reader does."""

from __future__ import annotations

import os

import pytest

pytest.importorskip("zenoh")

from rcp_fleet.stdout import reading


def test_lines_that_nobody_takes_are_written_also_if_a_reader_fails(
    capfd: pytest.CaptureFixture[str],
) -> None:
    heard: list[bytes] = []

    def take(line: bytes) -> bool:
        heard.append(line)
        if line == b"broken":
            raise ValueError(line)
        return line == b"taken"

    with reading(take):
        os.write(1, b"plain\ntaken\nbroken\n" + b"x" * 100_000 + b"\nhalf a line")
    os.write(1, b"\nafter\n")
    out = capfd.readouterr().out.splitlines()
    shown = ["plain", "broken", "half a line", "after"]
    assert [line for line in out if line in (*shown, "taken")] == shown
    assert "x" * 100_000 in out
    assert heard[:3] == [b"plain", b"taken", b"broken"]
