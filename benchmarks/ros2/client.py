"""N clients in one process: what arrives, and how old it is by the message's `header.stamp`.

python client.py rcp       ws://127.0.0.1:8080/rcp/v1/ws  --topic /sensor/odom [--encoding json|msgpack|native]
python client.py rosbridge ws://127.0.0.1:9090            --topic /odom [--type nav_msgs/msg/Odometry]
                                                          [--encoding json|cbor-raw]
python client.py foxglove  ws://127.0.0.1:8765            --topic /odom --encoding cdr
python client.py bare      ws://127.0.0.1:9999            (floor.py)

With `--service PATH` it calls a service of std_srvs/Trigger over and over instead. Prints a line when it
counts, then its result as JSON.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import re
import struct
import sys
import time
from pathlib import Path

import cbor2
import msgspec
import uvloop
from picows import WSListener, WSMsgType, ws_connect

sys.path.insert(0, str(Path(__file__).parents[1]))
from answers import Answers, message_of

HANDSHAKE = 30.0  # s: many clients at once on a busy machine
SHORT = 4096  # bytes below which a message may be an answer
SEC = re.compile(rb'"sec": ?(\d+), ?"nanosec": ?(\d+)')
SUBPROTOCOL = {"json": "rcp.v1.json", "msgpack": "rcp.v1.msgpack", "native": "rcp.v1.msgpack"}


class State:
    counting = False
    frames = 0
    bytes = 0
    ready = 0
    lost = 0
    ages: list[int]
    answers = Answers()


State.ages = []


def stamp_of(data: bytes, encoding: str) -> int:
    """Find the source's time, ns: texts by pattern, binary ones by decoding them."""
    if encoding == "json":
        found = SEC.search(data)
        return int(found[1]) * 10**9 + int(found[2]) if found else 0
    if encoding == "cbor-raw":
        message = cbor2.loads(data)["msg"]["bytes"]
        second, nano = struct.unpack_from("<iI", message, 4)
        return second * 10**9 + nano
    if encoding == "cdr":
        second, nano = struct.unpack_from("<iI", data, 13 + 4)
        return second * 10**9 + nano
    message = msgspec.msgpack.decode(data)
    if encoding == "native":
        second, nano = struct.unpack_from("<iI", message["body"], 4)
        return second * 10**9 + nano
    body = message["msg"] if "msg" in message else message["body"]
    stamp = body["header"]["stamp"]
    return stamp["sec"] * 10**9 + stamp["nanosec"]


class Subscriber(WSListener):
    def on_ws_connected(self, transport) -> None:
        self.ask(transport)
        State.ready += 1

    def ask(self, transport) -> None:
        if ARGS.protocol == "rcp":
            body = {"qos": {"depth": ARGS.depth}}
            if ARGS.encoding == "native":
                body["encoding"] = "native"
            ask = {"type": "subscribe", "id": "s", "path": ARGS.topic, "body": body}
            if ARGS.encoding == "json":
                transport.send(WSMsgType.TEXT, json.dumps(ask).encode())
            else:
                transport.send(WSMsgType.BINARY, msgspec.msgpack.encode(ask))
        elif ARGS.protocol == "rosbridge":
            ask = {"op": "subscribe", "topic": ARGS.topic, "queue_length": ARGS.depth}
            if ARGS.type:
                ask["type"] = ARGS.type
            if ARGS.encoding != "json":
                ask["compression"] = ARGS.encoding
            transport.send(WSMsgType.TEXT, json.dumps(ask).encode())

    def on_ws_frame(self, transport, frame) -> None:
        if not State.counting:
            if ARGS.protocol == "rcp" and frame.payload_size < SHORT:
                self.look(transport, frame.get_payload_as_bytes())
            if ARGS.protocol == "foxglove" and frame.msg_type == WSMsgType.TEXT:
                self.advertised(transport, json.loads(frame.get_payload_as_bytes()))
            return
        if frame.payload_size < 100:
            return
        State.frames += 1
        State.bytes += frame.payload_size
        if ARGS.protocol == "rcp":
            State.lost += b"dropped" in bytes(frame.get_payload_as_memoryview()[:256])
        # The age of every seventh: a client that decodes all would be what is measured.
        if State.frames % 7 == 0:
            now = time.time_ns()
            State.ages.append(now - stamp_of(frame.get_payload_as_bytes(), ARGS.encoding))

    def advertised(self, transport, message: dict) -> None:
        for one in message.get("channels", ()):
            if one["topic"] == ARGS.topic:
                wish = [{"id": 1, "channelId": one["id"]}]
                ask = {"op": "subscribe", "subscriptions": wish}
                transport.send(WSMsgType.TEXT, json.dumps(ask).encode())

    def look(self, transport, data: bytes) -> None:
        """Ask again where that may help: the robot may come up later than the gateway."""
        error = message_of(data).get("error")
        if error and error.get("retryable"):
            loop = asyncio.get_running_loop()
            loop.call_later(error.get("retry_after") or 0.5, self.ask, transport)
        else:
            State.answers.look(data)


class Caller(WSListener):
    """One call after another; the next one is sent when the answer is there."""

    def on_ws_connected(self, transport) -> None:
        self.count = 0
        self.ask(transport)
        State.ready += 1

    def ask(self, transport) -> None:
        self.count += 1
        self.sent = time.time_ns()
        if ARGS.protocol == "rosbridge":
            call = {"op": "call_service", "id": f"c{self.count}", "service": ARGS.service}
        else:
            call = {"type": "execute", "id": f"c{self.count}", "path": ARGS.service}
        transport.send(WSMsgType.TEXT, json.dumps(call).encode())

    def on_ws_frame(self, transport, frame) -> None:
        data = frame.get_payload_as_bytes()
        if b'"accepted"' in data or b'"in_progress"' in data:
            return
        if b'"success":true' not in data.replace(b": ", b":"):
            State.answers.refused = {"answer": data.decode("utf-8", "replace")}
            return
        if State.counting:
            State.frames += 1
            State.ages.append(time.time_ns() - self.sent)
        self.ask(transport)


async def main() -> None:
    headers = {}
    if ARGS.protocol == "rcp":
        headers["Sec-WebSocket-Protocol"] = SUBPROTOCOL[ARGS.encoding]
    if ARGS.protocol == "foxglove":
        headers["Sec-WebSocket-Protocol"] = "foxglove.sdk.v1"
    listener = Caller if ARGS.service else Subscriber
    for _ in range(ARGS.clients):
        await ws_connect(
            listener,
            ARGS.url,
            extra_headers=headers,
            max_frame_size=1 << 26,
            websocket_handshake_timeout=HANDSHAKE,
        )
    await asyncio.sleep(ARGS.settle)
    if State.answers.refused:
        State.answers.check(0)
    print("counting", flush=True)
    State.counting = True
    started = time.monotonic()
    await asyncio.sleep(ARGS.seconds)
    took = time.monotonic() - started
    State.counting = False
    State.answers.check(State.frames)
    ages = sorted(State.ages) or [0]
    result = {
        "frames": State.frames,
        "bytes": State.bytes,
        "seconds": took,
        "gaps": State.lost,
        "p50_ms": ages[len(ages) // 2] / 1e6,
        "p99_ms": ages[int(len(ages) * 0.99)] / 1e6,
    }
    print(json.dumps(result), flush=True)


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("protocol", choices=["rcp", "rosbridge", "foxglove", "bare"])
parser.add_argument("url")
parser.add_argument("--topic")
parser.add_argument("--type")
parser.add_argument("--service")
parser.add_argument(
    "--encoding", default="json", choices=["json", "msgpack", "native", "cbor-raw", "cdr"]
)
parser.add_argument("--clients", type=int, default=1)
parser.add_argument("--depth", type=int, default=16)
parser.add_argument("--seconds", type=float, default=4.0)
parser.add_argument("--settle", type=float, default=1.5)
ARGS = parser.parse_args()
uvloop.run(main())
