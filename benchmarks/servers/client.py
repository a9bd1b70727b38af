"""N subscribers in one process: count what arrives, and how old it is.

python client.py KIND PORT N SECONDS PATH: KIND is `rcp` or `foxglove`. Prints one JSON line.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from pathlib import Path

import msgspec
import uvloop
from picows import WSListener, WSMsgType, ws_connect

sys.path.insert(0, str(Path(__file__).parents[1]))
from answers import Answers

KIND, PORT, COUNT, SECONDS, PATH = (
    sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), sys.argv[5],
)  # fmt: skip
BINARY = PATH.endswith("blob")  # bytes travel as bytes
SENT = re.compile(rb'"sent":"?(\d+)')


class State:
    counting = False
    frames = 0
    bytes = 0
    dropped = 0
    ready = 0
    ages: list[int]
    answers = Answers()


State.ages = []


class Listener(WSListener):
    def on_ws_connected(self, transport) -> None:
        if KIND == "rcp":
            depth = {"depth": 512}
            envelope = {"type": "subscribe", "id": "s", "path": PATH, "body": {"qos": depth}}
            if BINARY:
                transport.send(WSMsgType.BINARY, msgspec.msgpack.encode(envelope))
            else:
                transport.send(WSMsgType.TEXT, json.dumps(envelope).encode())
            State.ready += 1

    def on_ws_frame(self, transport, frame) -> None:
        if not State.counting:
            if KIND == "rcp":
                State.answers.look(frame.get_payload_as_bytes())
            if KIND == "foxglove" and frame.msg_type == WSMsgType.TEXT:
                self.advertised(transport, json.loads(frame.get_payload_as_bytes()))
            return
        State.frames += 1
        State.bytes += frame.payload_size
        if State.frames % 7 == 0 and frame.payload_size < 2000:
            data = frame.get_payload_as_bytes()
            found = SENT.search(data)
            if found:
                State.ages.append(time.time_ns() // 1000 - int(found[1]))

    def advertised(self, transport, message) -> None:
        if message["op"] == "advertise":
            channel = message["channels"][0]["id"]
            wanted = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]}
            transport.send(WSMsgType.TEXT, json.dumps(wanted).encode())
            State.ready += 1


async def main() -> None:
    url = f"ws://127.0.0.1:{PORT}" + ("/rcp/v1/ws" if KIND == "rcp" else "/")
    protocol = "foxglove.sdk.v1"
    if KIND == "rcp":
        protocol = "rcp.v1.msgpack" if BINARY else "rcp.v1.json"
    for _ in range(COUNT):
        await ws_connect(
            Listener,
            url,
            extra_headers={"Sec-WebSocket-Protocol": protocol},
            max_frame_size=1 << 26,
        )
    while State.ready < COUNT:  # noqa: ASYNC110 - a benchmark may wait by the clock
        await asyncio.sleep(0.01)
    await asyncio.sleep(0.5)
    if State.answers.refused:
        State.answers.check(0)
    print("counting", flush=True)
    State.counting = True
    started = time.monotonic()
    await asyncio.sleep(SECONDS)
    took = time.monotonic() - started
    State.counting = False
    State.answers.check(State.frames)
    ages = sorted(State.ages) or [0]
    result = {
        "frames": State.frames,
        "bytes": State.bytes,
        "seconds": took,
        "p50_ms": ages[len(ages) // 2] / 1e3,
        "p99_ms": ages[int(len(ages) * 0.99)] / 1e3,
    }
    print(json.dumps(result), flush=True)


uvloop.run(main())
