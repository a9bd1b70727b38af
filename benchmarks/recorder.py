"""What recording 10,000 samples a second of 50 mixed paths costs, and that no e-stop waits for it.

Beside it the same gateway without a recorder, in the same run, and one with a black box that writes at
each stop while history is read. Late is how long a timer of the event loop waits beyond its time: what
recording delays, it delays by no more. An e-stop is measured from its request to the robot's `halt`.
Run: python benchmarks/recorder.py
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import uvloop
from mcap.reader import make_reader

import rcp_recorder
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.model import Resource
from rcp_kernel.types import PoseStamped, Twist, quantity
from rcp_profiles.messages import BatteryState
from rcpd.turns import take_short_turns

PATHS = 50
RATE = 10_000  # samples a second
SECONDS = 8
ROUNDS = 2
PAUSE = 0.03  # s between two e-stops, which come at any moment of the load
KEY = "admin-of-the-benchmark"
TICK = PATHS / RATE  # s: in each, one sample of every path


def resources() -> list[Resource]:
    types = (PoseStamped, Twist, quantity("m/s"), BatteryState, str)
    return [
        Resource(name=f"sensor/s{n}", description="One of many.", value=types[n % len(types)])
        for n in range(PATHS)
    ] + [Resource(name="actuator/drive", description="Moves.", value=quantity("m/s"), safe=0.0)]


def value(number: int, turn: int) -> object:
    x = turn * 0.001 + number
    match number % 5:
        case 0:
            return PoseStamped(position={"x": x, "y": -x})
        case 1:
            return Twist(linear={"x": x}, angular={"z": x})
        case 2:
            return x
        case 3:
            return BatteryState(percentage=0.5, voltage=x, current=None)
        case _:
            return f"state {turn}"


async def produce(robot: ScriptedRobot, late: list[float]) -> int:
    names = [f"sensor/s{n}" for n in range(PATHS)]
    begun, turn = time.perf_counter(), 0
    while (now := time.perf_counter()) - begun < SECONDS:
        due = begun + turn * TICK
        if now < due:
            await asyncio.sleep(due - now)
            late.append(time.perf_counter() - due)
        else:  # the machine is too slow for the rate, and others have their turn all the same
            await asyncio.sleep(0)
        for number, name in enumerate(names):
            robot.host.publish(name, value(number, turn))
        turn += 1
    return turn * PATHS


class Halted(ScriptedRobot):
    """Notes when it is told to stop first since the last reset."""

    at: float | None = None

    async def halt(self) -> None:
        if self.at is None:
            self.at = time.perf_counter()
        await super().halt()


async def stop_often(client, robot: Halted, took: list[float]) -> None:
    while True:
        await asyncio.sleep(PAUSE)
        robot.at = None
        begun = time.perf_counter()
        await client.request("execute", "/system/estop", body={})
        assert robot.at is not None
        took.append((robot.at - begun) * 1e3)
        await client.request("execute", "/system/estop", body={"reset": True})


async def read_history(client) -> None:
    while True:
        body = {"path": "/tenant/t/sensor/s0", "every": "1s"}
        await client.request("execute", "/system/history", body=body)


async def run(kind: str) -> None:
    recorded = kind != "bare"
    with tempfile.TemporaryDirectory() as folder:
        config = (
            '[[backends]]\nuse = "robot"\nname = "robot"\ntenant = "t"\n'
            f'[[keys]]\nname = "admin"\nrole = "admin"\nkey = "{KEY}"\n'
        )
        if recorded:
            config += (
                f'[features.recorder]\nfolder = "{folder}"\npaths = ["/tenant/**"]\nfree_mb = 0\n'
            )
        if kind == "busy":
            config += "[features.recorder.black_box]\nseconds = 5\nafter = 0\n"
        robot = scripted(lambda host: Halted(host, *resources()))
        features = rcp_recorder.rcp_features() if recorded else ()
        async with serve(config, robot, features=list(features)) as served:
            made = served.life.backend
            assert isinstance(made, Halted)
            late: list[float] = []
            before, begun = time.process_time(), time.perf_counter()
            sent = await produce(made, late)
            cpu, took = time.process_time() - before, time.perf_counter() - begun
            rate = sent / took
            stops: list[float] = []
            beside = [asyncio.ensure_future(stop_often(served.client(KEY), made, stops))]
            if kind == "busy":
                beside.append(asyncio.ensure_future(read_history(served.client(KEY))))
            sent += await produce(made, [])
            for task in beside:
                if task.done():
                    task.result()
                task.cancel()
        late.sort()
        stops.sort()
        print(
            json.dumps(
                {
                    "cpu": cpu / took,
                    "rate": rate,
                    "p99": late[int(len(late) * 0.99)] * 1e3,
                    "stops": len(stops),
                    **{
                        f"stop{share}": stops[min(len(stops) - 1, len(stops) * share // 1000)]
                        for share in (500, 900, 990, 1000)
                    },
                    "sent": sent,
                    **written(Path(folder)),
                }
            )
        )


def written(folder: Path) -> dict[str, int]:
    files = list(folder.glob("*.mcap"))
    return {"read": sum(map(count, files)), "bytes": sum(file.stat().st_size for file in files)}


def count(file: Path) -> int:
    with file.open("rb") as data:
        summary = make_reader(data).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return sum(
        summary.statistics.channel_message_counts[channel.id]
        for channel in summary.channels.values()
        if channel.metadata["kind"] == "sample"
    )


def measured(kind: str) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, __file__, kind], stdout=subprocess.PIPE, check=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    if sys.argv[1:]:
        take_short_turns()
        uvloop.run(run(sys.argv[1]))
        sys.exit()
    kinds = ("bare", "recorded", "busy")
    rounds = [{kind: measured(kind) for kind in kinds} for _ in range(ROUNDS)]
    best = {kind: min((one[kind] for one in rounds), key=lambda f: f["cpu"]) for kind in kinds}
    print(f"{'':9} samples/s   core  late p99   e-stops   p50   p90   p99   max (ms)")
    for kind, found in best.items():
        stops = " ".join(f"{found[f'stop{share}']:5.2f}" for share in (500, 900, 990, 1000))
        print(
            f"{kind:9} {found['rate']:9,.0f} {found['cpu']:6.1%} {found['p99']:6.2f} ms"
            f" {found['stops']:9,d} {stops}"
        )
    bare, full = best["bare"], best["recorded"]
    print(f"recording costs {full['cpu'] - bare['cpu']:.1%} of a core")
    print(
        f"{full['read']:,} of {full['sent']:,} samples are in the files, {full['bytes'] / full['read']:.0f} B each"
    )
