"""8 axes at 500 Hz set-point and feedback on python-can's virtual bus, on one core.

What jitters is measured on the bus, by a third node: how far the set-points of one axis are from 2 ms
apart. Beside it, bare python-can: a loop that sends and a Notifier that reads, without any gateway.
Run it with a real-time priority (`chrt -f 10`), or it measures what else the machine does.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from itertools import pairwise
from typing import Any

import can
import msgspec

from rcp_can import CanConfig, open_can
from rcp_can.sim import Bench, make_twin

AXES, RATE, SECONDS = 8, 500, 8.0


class NullHost:
    """A host that counts and keeps nothing: the kernel's own cost is measured elsewhere."""

    tenant, robot = "bench", None
    published = 0

    def declare(self, *_: Any) -> None:
        pass

    def publish(self, *_: Any) -> None:
        self.published += 1

    def report(self, *_: Any, **__: Any) -> None:
        pass


class Monitor:
    """A third node that notes when each axis is sent a set-point, and when it answers."""

    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(channel, "virtual", ignore_config=True)
        self.sent: dict[int, list[float]] = {n: [] for n in range(1, AXES + 1)}
        self.answers = 0
        self._stop = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop:
            message = self.bus.recv(0.1)
            if message is None:
                continue
            if message.arbitration_id in self.sent:
                self.sent[message.arbitration_id].append(message.timestamp)
            else:
                self.answers += 1

    def close(self) -> None:
        self._stop = True
        self._thread.join()
        self.bus.shutdown()

    def told(self, name: str, seconds: float, cpu: float) -> None:
        off = sorted(
            abs(b - a - 1 / RATE) * 1e3
            for stamps in self.sent.values()
            for a, b in pairwise(stamps)
        )
        count = sum(map(len, self.sent.values()))
        p50, p99, worst = off[len(off) // 2], off[int(len(off) * 0.99)], off[-1]
        print(
            f"{name:<18} {count / seconds:7.0f} set-points/s {self.answers / seconds:7.0f} answers/s"
            f"   jitter p50 {p50:.2f} p99 {p99:.2f} worst {worst:.1f} ms   CPU {cpu / seconds:.0%}"
        )


def twins(channel: str) -> Bench:
    line = can.Bus(channel, "virtual", ignore_config=True)
    return Bench(line, [make_twin("mit", n, reply_id=0x100) for n in range(1, AXES + 1)])


async def ours() -> None:
    channel = "bench-ours"
    motor = {"bus": "can0", "profile": "mit", "rate": RATE, "options": {"reply_id": 0x100}}
    table = {
        "buses": {"can0": {"interface": "virtual", "channel": channel}},
        "motors": {f"m{n}": {**motor, "node": n} for n in range(1, AXES + 1)},
    }
    host: Any = NullHost()
    with twins(channel):
        async with open_can(msgspec.convert(table, CanConfig), host) as backend:
            for n in range(1, AXES + 1):
                await backend.execute(f"service/m{n}/enable", None, lambda *_, **__: None)
                await backend.write(f"actuator/m{n}/velocity", 1.0)
            await asyncio.sleep(0.5)
            monitor = Monitor(channel)
            cpu = time.process_time()
            await asyncio.sleep(SECONDS)
            monitor.told("rcp_can", SECONDS, time.process_time() - cpu)
            monitor.close()


async def bare() -> None:
    channel = "bench-bare"
    data = bytes(8)
    with twins(channel):
        bus = can.Bus(channel, "virtual", ignore_config=True)
        heard: list[float] = []
        notifier = can.Notifier(
            bus, [lambda m: heard.append(m.timestamp)], loop=asyncio.get_running_loop()
        )
        monitor = Monitor(channel)
        cpu, start = time.process_time(), time.monotonic()
        due = start
        while due < start + SECONDS:
            for n in range(1, AXES + 1):
                bus.send(can.Message(arbitration_id=n, data=data, is_extended_id=False))
            due += 1 / RATE
            await asyncio.sleep(max(0.0, due - time.monotonic()))
        monitor.told("bare python-can", SECONDS, time.process_time() - cpu)
        notifier.stop()
        monitor.close()
        bus.shutdown()


if __name__ == "__main__":
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    try:
        import uvloop
    except ImportError:
        uvloop = None
    for run in (bare, ours):
        if uvloop is not None and "--asyncio" not in sys.argv:
            uvloop.run(run())
        else:
            asyncio.run(run())
