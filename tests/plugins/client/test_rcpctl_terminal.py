"""`rcpctl` as a person at a terminal has it: Ctrl-C, colours, tables that fit."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import time
from codecs import getincrementaldecoder
from typing import Self

from plugins.client.rcpctl import BIN, BOUND, FAR, OPERATOR, Run, document, documents


class Terminal:
    """`rcpctl` with a terminal for its input and output."""

    def __init__(self, url: str, *arguments: str) -> None:
        self._main, side = pty.openpty()
        self.text = ""
        self._decoder = getincrementaldecoder("utf-8")()  # a letter may come in two parts
        self.process = subprocess.Popen(
            [BIN / "rcpctl", *arguments],
            stdin=side,
            stdout=side,
            stderr=side,
            start_new_session=True,
            env={**os.environ, "RCP_URL": url, "RCP_TOKEN": OPERATOR, "COLUMNS": "100"}
            | {"TERM": "xterm-256color"},  # CI has a dumb one
        )
        os.close(side)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(BOUND)
        os.close(self._main)

    def until(self, wanted: str) -> None:
        """Read until a text has been shown."""
        end = time.monotonic() + BOUND
        while wanted not in self.text:
            ready, _, _ = select.select([self._main], [], [], end - time.monotonic())
            assert ready, self.text
            self.text += self._decoder.decode(os.read(self._main, 65_536))

    def interrupt(self) -> None:
        self.process.send_signal(signal.SIGINT)

    def wait(self) -> int:
        """Read to the end and return the exit status."""
        end = time.monotonic() + BOUND
        try:
            while True:
                left = max(0.0, end - time.monotonic())
                assert select.select([self._main], [], [], left)[0], self.text
                data = os.read(self._main, 65_536)
                if not data:
                    break
                self.text += self._decoder.decode(data)
        except OSError:  # Linux' way of saying that the other side is closed
            pass
        return self.process.wait(BOUND)


def test_the_first_interrupt_cancels_the_command_and_waits_for_its_end(run: Run, url: str) -> None:
    with Terminal(url, "execute", "/action/move_to", FAR) as terminal:
        terminal.until("in_progress")
        terminal.interrupt()
        assert terminal.wait() == 130
        assert "Ctrl-C again to stop waiting" in terminal.text
        assert "was cancelled" in terminal.text
    assert documents(run("commands"))[0]["status"] == "cancelled"


def test_the_second_interrupt_leaves(run: Run, url: str) -> None:
    unheard = '{"fault": "stop_lost", "count": 100}'  # so that the cancel does not end before it
    document(run("execute", "/service/inject_fault", unheard))
    with Terminal(url, "execute", "/action/move_to", FAR) as terminal:
        terminal.until("in_progress")
        terminal.interrupt()
        terminal.until("Ctrl-C again")
        terminal.interrupt()
        assert terminal.wait() == 130
        assert "Traceback" not in terminal.text


def test_an_interrupt_ends_a_watch(url: str) -> None:
    with Terminal(url, "watch", "/sensor/pose", "--rate", "20") as terminal:
        terminal.until("/tenant/alpha/sensor/pose")
        terminal.interrupt()
        assert terminal.wait() == 130
        assert "Traceback" not in terminal.text


def test_the_status_is_kept_up_to_date(url: str) -> None:
    with Terminal(url, "status", "--watch") as terminal:
        terminal.until("\x1b[H\x1b[2J")
        terminal.until("\x1b[32mok\x1b[0m  version")
        terminal.interrupt()
        assert terminal.wait() == 130


def test_a_table_fits_the_terminal(url: str) -> None:
    with Terminal(url, "discover") as terminal:
        assert terminal.wait() == 0
        assert "\x1b[32mready" in terminal.text
        assert "…" in terminal.text


def test_robots_are_a_table_on_a_terminal_and_json_in_a_pipe(run: Run, url: str) -> None:
    with Terminal(url, "robots", "rover") as terminal:
        assert terminal.wait() == 0
        head, row = terminal.text.splitlines()
        assert "ROBOT" in head
        assert "/tenant/alpha" in row
        assert "\x1b[32mready" in row
        assert "{" not in terminal.text
    assert document(run("robots", "rover"))["path"] == "/tenant/alpha"
