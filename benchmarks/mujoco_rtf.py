"""How fast the robots with physics run: in real time, as fast as they can, and stepped by a client.

Run: python benchmarks/mujoco_rtf.py (needs `pip install 'rcp-gateway[mujoco]'`)
"""

from __future__ import annotations

import asyncio
import logging
import statistics
import time
from typing import Any

import psutil
import structlog

import rcp_mujoco
from rcp_gateway.testing import Served, eventually, serve_backend
from rcp_gateway.testing._serve import OPERATOR

KIND = next(iter(rcp_mujoco.rcp_backends()))
SETTLE, MEASURED = 2.0, 10.0  # s
STEPS = 1000
SUBSTEPS = 5
ACTIONS = {
    "rover": ("action/move_to", {"position": {"x": 4.0, "y": 0.0}, "speed": 0.3}),
    "arm": ("action/move_joints", {"positions": {"joint_1": 2.0}, "speed": 0.08}),
}
CONTROLS = {
    "rover": {"left_wheel": 4.0, "right_wheel": 3.0},
    "arm": {"joint_1": 0.1, "joint_2": 0.3},
}


async def simulated(client: Any) -> float:
    reply = await client.request("read", "/tenant/t/sensor/simulation", body={"fresh": True})
    return reply["body"]["time"]


async def running(model: str, factor: float, *, acting: bool, watched: tuple[str, ...] = ()) -> str:
    """Tell the real-time factor and CPU of a robot, at rest or carrying out an action."""
    config = {"model": model, "real_time_factor": factor, "cameras": "camera" in watched}
    async with serve_backend(KIND, config) as served:
        client = await opened(served)
        if acting:
            name, goal = ACTIONS[model]
            await client.send(type="execute", path=f"/tenant/t/{name}", body=goal)

        async def declared() -> bool:  # OpenGL is loaded after the start
            return all(f"sensor/{name}" in served.life.host.resources for name in watched)

        await eventually(declared, "what is watched is declared", 60.0)
        for name in watched:
            await client.send(type="subscribe", path=f"/tenant/t/sensor/{name}", body={})
        await asyncio.sleep(SETTLE)
        process = psutil.Process()
        began, start, cpu = time.perf_counter(), await simulated(client), process.cpu_times()
        await asyncio.sleep(MEASURED)
        wall = time.perf_counter() - began
        done = (await simulated(client) - start) / wall
        now = process.cpu_times()
        used = (now.user + now.system - cpu.user - cpu.system) / wall
    per_cpu = done / used
    return f"real-time factor {done:6.2f}, {100 * used:5.1f} % of a core, {per_cpu:5.1f} s a CPU-second"


async def stepped(model: str) -> str:
    """Tell how many times a second a client can decide on an action."""
    config = {"model": model, "paused": True, "cameras": False}
    async with serve_backend(KIND, config) as served:
        client = await opened(served)
        body = {"steps": SUBSTEPS, "controls": CONTROLS[model]}
        took: list[float] = []
        began_cpu = time.process_time()
        for _ in range(STEPS):
            began = time.perf_counter()
            reply = await client.request("execute", "/tenant/t/service/step", body=body)
            took.append(time.perf_counter() - began)
            assert reply["status"] == "completed", reply
        used = 1e3 * (time.process_time() - began_cpu) / STEPS
        await client.request("execute", "/tenant/t/service/reset")
    p50, p99 = statistics.median(took), statistics.quantiles(took, n=100)[98]
    rate = len(took) / sum(took)
    return (
        f"{rate:.0f} decisions/s of {SUBSTEPS} steps, p50 {1e3 * p50:.2f} ms, "
        f"p99 {1e3 * p99:.2f} ms, {used:.2f} ms of CPU each"
    )


async def opened(served: Served) -> Any:
    await served.supervisor.settled.wait()
    return served.client(OPERATOR)


async def main() -> None:
    quiet = structlog.make_filtering_bound_logger(logging.ERROR)
    structlog.configure(wrapper_class=quiet)
    for model in ACTIONS:
        print(f"{model}")
        print("  at rest, 1x        ", await running(model, 1.0, acting=False))
        print("  in motion, 1x      ", await running(model, 1.0, acting=True))
        if model == "rover":
            print(
                "  with lidar watched ", await running(model, 1.0, acting=True, watched=("scan",))
            )
        watched = ("camera",)
        print("  with camera watched", await running(model, 1.0, acting=True, watched=watched))
        print("  as fast as it can  ", await running(model, 1000.0, acting=True))
        print("  stepped by a client", await stepped(model))


if __name__ == "__main__":
    asyncio.run(main())
