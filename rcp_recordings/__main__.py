"""Answers one query and ends: `python -m rcp_recordings`, with the query in JSON on standard input.

The gateway starts it, so that a long answer takes neither its memory nor its interpreter. The first line
of the output is `{}`, or `{"error": …}`; what was asked for follows.
"""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO

import msgspec

from rcp_recordings.answers import answer
from rcp_recordings.query import Query


class _Output:
    """Standard output, with the first line ahead of whatever is written first."""

    def __init__(self, out: IO[bytes]) -> None:
        self._out = out
        self._count = 0
        self.begun = False
        self.closed = False

    def write(self, data: bytes) -> int:
        """Write bytes."""
        if not self.begun:
            self.begun = True
            self._out.write(b"{}\n")
        self._count += len(data)
        return self._out.write(data)

    def tell(self) -> int:
        """Return the number of bytes."""
        return self._count

    def flush(self) -> None:
        """Pass everything on."""
        self._out.flush()

    def readable(self) -> bool:
        """Return that it is not."""
        return False

    def writable(self) -> bool:
        """Return that it is."""
        return True

    def seekable(self) -> bool:
        """Return that it is not."""
        return False

    def close(self) -> None:
        """Leave it open: nothing else follows."""


def main() -> None:
    """Answer the query."""
    os.nice(5)
    out = _Output(sys.stdout.buffer)
    query = msgspec.json.decode(sys.stdin.buffer.read(), type=Query)
    with ExitStack() as stack:
        try:
            answer(query, [(Path(path), size) for path, size in query.files], stack, out)  # pyright: ignore[reportArgumentType]
        except BrokenPipeError:
            os._exit(1)  # whoever asked is gone
        except Exception as error:
            if out.begun:  # the answer breaks off, which its length tells
                raise
            told = {"error": str(error) or type(error).__name__, "kind": type(error).__name__}
            sys.stdout.buffer.write(msgspec.json.encode(told) + b"\n")
    with suppress(BrokenPipeError):
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
