"""A process that records until it is killed; run with a folder, it prints what is flushed."""

from __future__ import annotations

import itertools
import sys
import time

from files import message, stream

from rcp_recorder.config import RecorderConfig
from rcp_recorder.mcap_file import OpenFile
from rcp_recorder.writer import Writer


def record(folder: str) -> None:
    writer = Writer(RecorderConfig(folder, free_mb=0), lambda: None, OpenFile)
    writer.start()
    one = stream()
    for number in itertools.count(1):
        now = time.time_ns()
        writer.add(one, message(number, now, 100))
        sys.stdout.write(f"{number} {now}\n")
        sys.stdout.flush()
        time.sleep(0.0005)


if __name__ == "__main__":
    record(sys.argv[1])
