"""The output of `rcpctl`: JSON lines for programs; tables, colours and short values for people."""

from __future__ import annotations

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from rcp_client.console.formats import as_json, writer_of
from rcp_client.console.remedies import remedy_of
from rcp_client.errors import ConnectionLost
from rcp_protocol.errors import RcpError
from rcp_protocol.values import Encoding, dump, parse
from rcp_protocol.wire import error_body

__all__ = ["Output", "compact", "exit_code", "pretty"]

_COLORS = {
    "32": "ok ready fresh completed confirmed",  # green
    "33": "degraded starting opening stale pending accepted in_progress cancelled never closing "
    "requested commanded",
    "31": "down failed rejected unavailable error critical latched alarm",
}
_COLOR_OF = {word: code for code, words in _COLORS.items() for word in words.split()}
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_WIDE = 88  # characters per line
_SHORT = 200  # characters of a string inside a displayed value


def exit_code(error: BaseException) -> int:
    """Return the exit status of an error."""
    if isinstance(error, ConnectionLost) and error.retryable:
        return 4  # a script may wait for the gateway and repeat the command
    return 3 if isinstance(error, RcpError) and error.status == "rejected" else 1


def pretty(value: Any) -> str:
    """Format a value for people, on one line if it fits, otherwise indented."""
    return "\n".join(_layout(parse(_encoded(_shortened(value)), Encoding.JSON), ""))


def _layout(value: Any, indent: str) -> list[str]:
    line = msgspec.json.format(msgspec.json.encode(value), indent=0).decode()
    if len(line) + len(indent) <= _WIDE or not value or not isinstance(value, (dict, list)):
        return [line]
    deeper = indent + "  "
    if isinstance(value, dict):
        parts = [(f"{msgspec.json.encode(key).decode()}: ", item) for key, item in value.items()]
    elif any(isinstance(item, (dict, list)) for item in value):
        parts = [("", item) for item in value]
    else:
        filled = textwrap.fill(line[1:-1], _WIDE, initial_indent=deeper, subsequent_indent=deeper)
        return ["[", *filled.splitlines(), indent + "]"]
    lines = ["{" if isinstance(value, dict) else "["]
    for place, (head, item) in enumerate(parts):
        first, *rest = _layout(item, deeper)
        lines += [deeper + head + first, *rest]
        lines[-1] += "," * (place < len(parts) - 1)
    return [*lines, indent + ("}" if isinstance(value, dict) else "]")]


def compact(value: Any) -> str:
    """Format a value for people on one line."""
    return msgspec.json.format(_encoded(_shortened(value)), indent=0).decode()


def _encoded(value: Any) -> bytes:
    return dump(value, Encoding.JSON)


def _shortened(value: Any) -> Any:
    match value:
        case bytes() | bytearray() | memoryview() if len(value) > 24:
            return f"<{len(value)} bytes>"
        case str() if len(value) > _SHORT:
            return f"{value[:_SHORT]}… <{len(value)} characters>"
        case float():
            return float(f"{value:.6g}")
        case dict():
            return {key: _shortened(item) for key, item in value.items()}
        case list() | tuple():
            shown = [_shortened(item) for item in value[:50]]
            return shown if len(value) <= 50 else [*shown, f"<{len(value)} items>"]
        case _:
            return value


class Output:
    """Standard output and error of one command."""

    def __init__(self, wanted: str | None) -> None:
        terminal = sys.stdout.isatty()
        self._write = writer_of(wanted or ("table" if terminal else "json"))
        self.json = self._write is not None
        """Whether documents are written for a program, in JSON or another format."""
        self.asked_json = wanted not in (None, "table")
        self.terminal = terminal
        self.colors = terminal and "NO_COLOR" not in os.environ
        self._before: set[bytes] | None = None
        self._round: set[bytes] | None = None

    def begin_round(self) -> None:
        """Leave out documents of the round before from now on: those that have not changed."""
        self._before, self._round = self._round, set()

    def line(self, text: str = "") -> None:
        """Print a line immediately."""
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    def document(self, value: Any) -> None:
        """Print a complete value in the format for programs, one line of JSON by default."""
        data = (self._write or as_json)(value)
        if self._round is not None:
            self._round.add(data)
            if self._before is not None and data in self._before:
                return
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()

    def aside(self, text: str) -> None:
        """Print a line on standard error."""
        sys.stderr.write(clean(text) + "\n")
        sys.stderr.flush()

    def error(self, error: RcpError) -> None:
        """Print an error and its remedy on one line."""
        if self.asked_json:
            sys.stderr.write(dump({"error": error_body(error)}, Encoding.JSON).decode() + "\n")
            return
        self.aside(f"rcpctl: {error.message.rstrip('.')}. {remedy_of(error)}")

    def paint(self, word: str) -> str:
        """Colour a word that names a state."""
        code = _COLOR_OF.get(word.strip())
        return f"\x1b[{code}m{word}\x1b[0m" if self.colors and code else word

    def dim(self, text: str) -> str:
        """Dim a less important text."""
        return f"\x1b[2m{text}\x1b[0m" if self.colors else text

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Print a table with a header."""
        self._columns([head, *rows], head=True)

    def rows(self, rows: Iterable[Sequence[Any]]) -> None:
        """Print rows in columns; on a terminal the last column is cut at the edge."""
        self._columns(list(rows), head=False)

    def _columns(self, rows: Sequence[Sequence[Any]], *, head: bool) -> None:
        texts = [["" if cell is None else clean(str(cell)) for cell in row] for row in rows]
        widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
        edge = shutil.get_terminal_size().columns if self.terminal else 10_000
        room = max(10, edge - sum(widths[:-1]) - 2 * (len(widths) - 1))
        for place, (*cells, last) in enumerate(texts):
            cut = last if len(last) <= room else last[: room - 1] + "…"
            padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=False)]
            if head and place == 0:
                self.line(self.dim("  ".join([*padded, cut]).rstrip()))
            else:
                self.line("  ".join(map(self.paint, [*padded, cut])).rstrip())


def clean(text: str) -> str:
    """Remove terminal control characters."""
    return _CONTROL.sub("�", text)
