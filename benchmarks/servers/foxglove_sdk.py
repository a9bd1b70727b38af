"""foxglove-sdk's WebSocket server with the same producer; the SDK is Rust below.

python foxglove_sdk.py RATE BURST SIZE, as gateway.py; messages are encoded beforehand.
"""

from __future__ import annotations

import os
import sys
import time

import foxglove
from source import encoded

RATE, BURST, SIZE = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
server = foxglove.start_server(name="bench", host="127.0.0.1", port=0)
channel = foxglove.Channel("/update", message_encoding="json")
print(server.port, flush=True)

blob = os.urandom(SIZE)
period, due = BURST / RATE, time.monotonic()
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(BURST):
        channel.log(blob if SIZE else encoded(time.time_ns() // 1000))
    due = max(due + period, time.monotonic() - period)
    time.sleep(max(0.0, due - time.monotonic()))
server.stop()
