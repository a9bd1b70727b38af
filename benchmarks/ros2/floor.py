"""The least that any server must do, for comparison: no paths, no types, no rights, no filters.

Serialised subscription (events executor) -> compiled decoder -> msgspec -> encoded once -> one
send for each client. Whoever connects gets every message of the one topic.

python floor.py PORT nav_msgs/msg/Odometry /odom [json|binary|cdr]     or     python floor.py PORT --service /reset
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
from collections import deque

import msgspec
import rclpy
import uvloop
from picows import WSListener, WSMsgType, ws_create_server
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future

from rcp_ros2.cdr import Codec
from rcp_ros2.idl import load

CLIENTS: set = set()
_FRAME = b"\x01" + bytes(12)


class Client(WSListener):
    def on_ws_connected(self, transport) -> None:
        CLIENTS.add(transport)

    def on_ws_disconnected(self, transport) -> None:
        CLIENTS.discard(transport)


class Caller(WSListener):
    call = None
    loop = None

    def on_ws_connected(self, transport) -> None:
        self.transport = transport

    def on_ws_frame(self, transport, frame) -> None:
        id_ = msgspec.json.decode(frame.get_payload_as_bytes())["id"]
        Caller.call(lambda done: self.loop.call_soon_threadsafe(self.reply, id_, done.result()))

    def reply(self, id_: str, response) -> None:
        body = {"success": response.success, "message": response.message}
        self.transport.send(
            WSMsgType.TEXT, msgspec.json.encode({"id": id_, "status": "completed", "body": body})
        )


def follow(node, loop, type_: str, topic: str, encoding: str) -> None:
    cls = load(type_)
    codec = Codec(cls)
    encode = msgspec.json.encode if encoding == "json" else msgspec.msgpack.encode
    kind = WSMsgType.TEXT if encoding == "json" else WSMsgType.BINARY
    queue: deque = deque(maxlen=64)
    woken = False

    def drain() -> None:
        nonlocal woken
        woken = False
        while queue:
            data = queue.popleft()
            if encoding == "cdr":  # as the Foxglove protocol frames it
                body = _FRAME + data
            else:
                body = encode({"op": "publish", "msg": codec.decode(data)})
            for client in CLIENTS:
                client.send(kind, body)

    def heard(data: bytes) -> None:
        nonlocal woken
        queue.append(data)
        if not woken:
            woken = True
            loop.call_soon_threadsafe(drain)

    node.create_subscription(cls, topic, heard, 10, raw=True)


async def main() -> None:
    port, *rest = sys.argv[1:]
    loop = asyncio.get_running_loop()
    rclpy.init()
    node = rclpy.create_node("floor")
    executor = EventsExecutor()
    executor.add_node(node)
    if rest[0] == "--service":
        from std_srvs.srv import Trigger

        service = node.create_client(Trigger, rest[1])

        def call(done) -> None:
            executor.create_task(
                lambda: service.call_async(Trigger.Request()).add_done_callback(done)
            )

        Caller.call, Caller.loop = call, loop
        await ws_create_server(lambda _: Caller(), "127.0.0.1", int(port))
    else:
        follow(node, loop, *rest)
        await ws_create_server(lambda _: Client(), "127.0.0.1", int(port))

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin_until_future_complete(Future(), timeout_sec=1e7)

    threading.Thread(target=spin, daemon=True).start()
    await asyncio.to_thread(sys.stdin.read)


uvloop.run(main())
