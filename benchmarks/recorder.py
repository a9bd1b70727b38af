"""What recording 10,000 samples a second of 50 mixed paths costs. Run: python benchmarks/recorder.py

Beside it the same gateway without a recorder, in the same run. Late is how long a timer of the event
loop waits beyond its time: what recording delays, it delays by no more.
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
from rcp_kernel.model import Resource
from rcp_kernel.testing import ScriptedRobot, scripted, serve
from rcp_kernel.types import PoseStamped, Twist, quantity
from rcp_profiles.messages import BatteryState

PATHS = 50
RATE = 10_000  # samples a second
SECONDS = 8
ROUNDS = 2
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
        for number, name in enumerate(names):
            robot.host.publish(name, value(number, turn))
        turn += 1
    return turn * PATHS


async def run(*, recorded: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        config = (
            '[[backends]]\nuse = "robot"\nname = "robot"\ntenant = "t"\n'
            f'[[keys]]\nname = "admin"\nrole = "admin"\nkey = "{KEY}"\n'
        )
        if recorded:
            config += (
                f'[features.recorder]\nfolder = "{folder}"\npaths = ["/tenant/**"]\nfree_mb = 0\n'
            )
        robot = scripted(lambda host: ScriptedRobot(host, *resources()))
        features = rcp_recorder.rcp_features() if recorded else ()
        async with serve(config, robot, features=list(features)) as served:
            made = served.life.backend
            assert isinstance(made, ScriptedRobot)
            late: list[float] = []
            before, begun = time.process_time(), time.perf_counter()
            sent = await produce(made, late)
            cpu, took = time.process_time() - before, time.perf_counter() - begun
            client = served.client(KEY)
            stop = time.perf_counter()
            await client.request("execute", "/system/estop", body={})
            stop = time.perf_counter() - stop
        late.sort()
        print(
            json.dumps(
                {
                    "cpu": cpu / took,
                    "rate": sent / took,
                    "p99": late[int(len(late) * 0.99)] * 1e3,
                    "stop": stop * 1e3,
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


def measured(recorded: str) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, __file__, recorded], stdout=subprocess.PIPE, check=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    if sys.argv[1:]:
        uvloop.run(run(recorded=sys.argv[1] == "recorded"))
        sys.exit()
    rounds = [(measured("bare"), measured("recorded")) for _ in range(ROUNDS)]
    bare = min((one for one, _ in rounds), key=lambda one: one["cpu"])
    full = min((one for _, one in rounds), key=lambda one: one["cpu"])
    print(f"{'':10} samples/s   core   timer late p99   e-stop")
    for name, found in (("bare", bare), ("recorded", full)):
        print(
            f"{name:10} {found['rate']:9,.0f} {found['cpu']:6.1%} {found['p99']:11.2f} ms"
            f" {found['stop']:9.2f} ms"
        )
    print(f"recording costs {full['cpu'] - bare['cpu']:.1%} of a core")
    print(
        f"{full['read']:,} of {full['sent']:,} samples are in the files, {full['bytes'] / full['read']:.0f} B each"
    )
