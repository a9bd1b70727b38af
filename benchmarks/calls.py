"""Python calls of one request over WebSocket, and the files that it goes through.

Run: python benchmarks/calls.py [KIND…] [--list]. What a reader of the code has to follow is what this
counts, from the frame to the last reply: functions of this repository, on the event loop's thread.
`--list` shows them in their order; `--bare` leaves out the features that are on by default (audit, guard
and so on). The clocks stand still, so that no turn of the loop is over early.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import sys
import tempfile
import time
from pathlib import Path
from types import FrameType
from typing import Self

import uvloop
from picows import WSListener, WSMsgType, ws_connect

time.thread_time = time.perf_counter = itertools.repeat(1.0).__next__

from instructions import ASKED, STORE, execute  # noqa: E402 - after the clocks
from served import Bench, gateway  # noqa: E402

from rcp_kernel.model import Resource  # noqa: E402

ROOT = str(Path(__file__).resolve().parents[1])
ELSEWHERE = (f"{ROOT}/.venv", f"{ROOT}/benchmarks")
WARM = 5
TURNS = 8  # of the loop after the last reply, in which the rest of the request is done
BARE = "[features]\naudit = false\nguard = false\n"
ANYBODY = '[anonymous]\nrole = "operator"\n'


class Walk:
    """The calls made while it is entered."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, str, str]] = []
        self._depth = 0

    def __enter__(self) -> Self:
        sys.setprofile(self._note)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _note(self, frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            code = frame.f_code
            if code.co_filename.startswith(ROOT) and not code.co_filename.startswith(ELSEWHERE):
                file = code.co_filename.removeprefix(ROOT + "/")
                self.calls.append((self._depth, code.co_qualname, f"{file}:{frame.f_lineno}"))
            self._depth += 1
        elif event == "return":
            self._depth = max(0, self._depth - 1)


class Client(WSListener):
    """Sends one request at a time."""

    def __init__(self) -> None:
        self.done = asyncio.Event()

    def on_ws_frame(self, _transport, frame):
        data = frame.get_payload_as_bytes()
        if b'"error"' in data:
            raise SystemExit(data.decode())
        if b'"accepted"' not in data and b'"in_progress"' not in data:
            self.done.set()


async def walk(kind: str, features: str) -> Walk:
    """Walk through one request of a gateway that has answered some already."""
    Bench.execute = execute  # pyright: ignore[reportAttributeAccessIssue]
    with tempfile.TemporaryDirectory() as folder:
        kept = STORE.format(folder) if kind.startswith("kept") else ""
        async with gateway(features + ANYBODY + kept) as (robot, url):
            about = {"input": float, "output": float, "feedback": float}
            robot.host.declare(Resource(name="action/count", description="Counts.", **about))
            place = url.replace("http", "ws", 1) + "/rcp/v1/ws"
            transport, client = await ws_connect(Client, place)
            for number in range(WARM + 1):
                client.done.clear()
                asked = json.dumps({"id": f"c-{number}", **ASKED[kind]}).encode()
                with Walk() as found:
                    transport.send(WSMsgType.TEXT, asked)
                    await client.done.wait()
                    for _ in range(TURNS):
                        await asyncio.sleep(0)
            transport.disconnect()
            return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=tuple(ASKED), metavar="KIND")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--bare", action="store_true")
    asked = parser.parse_args()
    for kind in asked.kinds:
        calls = uvloop.run(walk(kind, BARE if asked.bare else "")).calls
        if asked.list:
            for depth, name, place in calls:
                print(f"{'  ' * depth}{name}  {place}")
        files = {place.partition(":")[0] for _, _, place in calls}
        print(f"  {kind:14} {len(calls):4} calls   {len(files):3} files")


if __name__ == "__main__":
    main()
