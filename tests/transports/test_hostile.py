"""What a hostile client sends, while an e-stop and a reader are timed from another process."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import httpx
import pytest

from hostility.cases import CASES, Case
from hostility.scene import Worst, attacked, served
from serving import ROVER, serving
from timing import in_one_of_three_attempts, in_time

pytestmark = pytest.mark.anyio
COLD = "sensor.joint_states.position"
PLANS = "/rcp/v1/context/system/plans"
IN_TIME = 0.7  # s until an e-stop is answered, on a machine that is busy otherwise


def nested(levels: int, over: str = COLD) -> str:
    return f"{over}.all(x, " * levels + "false" + ")" * levels


def waits(*conditions: str) -> dict[str, Any]:
    steps = [{"do": "wait", "until": text, "deadline": 2} for text in conditions]
    return {"steps": [{"do": "parallel", "steps": steps}]}


CELL = "[" + ",".join(["1"] * 50) + "]"
DEAR = [
    pytest.param(waits(nested(28)), 422, id="900 characters"),
    pytest.param(waits(nested(3)), 422, id="three levels"),
    pytest.param(waits(nested(10, f"{CELL[:41]}]")), 422, id="literal lists"),
    pytest.param(waits(*[nested(2)] * 60), 202, id="the most that is admitted"),
    pytest.param(
        waits(*[f"{CELL}.all(x, {CELL}.all(y, {n} < 0 && x > y))" for n in range(30)]),
        202,
        id="literal lists as far as admitted",
    ),
]


FLOOD = """
import asyncio, json, sys, httpx

async def main(url, key):
    plan = json.load(sys.stdin)
    async with httpx.AsyncClient(base_url=url, timeout=60, headers={"authorization": key}) as client:
        path = "/rcp/v1/context/system/plans"
        replies = await asyncio.gather(*(client.post(path, json=plan) for _ in range(100)))
    print(json.dumps(sorted({reply.status_code for reply in replies})), flush=True)

asyncio.run(main(*sys.argv[1:]))
"""


@pytest.mark.serial
@pytest.mark.parametrize(("plan", "status"), DEAR)
@in_one_of_three_attempts
async def test_an_estop_is_answered_while_a_hundred_dear_plans_are_sent(
    tmp_path: Path, plan: dict[str, Any], status: int
) -> None:
    with serving(tmp_path / "rcp.toml", ROVER) as url:
        async with httpx.AsyncClient(base_url=url, timeout=60, headers=_as("admin")) as safe:
            # Before any stop: what is admitted at all is refused with 423 while the e-stop is latched.
            first = await safe.post(PLANS, json=plan, headers=_as("operator"))
            assert first.status_code == status, first.text
            hostile = await asyncio.create_subprocess_exec(
                sys.executable,
                "-c",
                FLOOD,
                url,
                _as("operator")["authorization"],
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
            )
            flood = asyncio.create_task(_flood(hostile, plan, runs=status == 202))
            worst = 0.0
            while not flood.done():
                began = time.perf_counter()
                stop = await safe.post("/rcp/v1/context/system/estop", json={"scope": "rover"})
                worst = max(worst, time.perf_counter() - began)
                assert stop.status_code == 200, stop.text
                await asyncio.sleep(0.02)
            told = await flood
        assert told <= {status, 422, 423, 429, 503}
        in_time(worst, IN_TIME)


MANY = 10  # attackers at once
SHORT = 1.0  # s that an attack is watched
ATTEMPTS = 3  # what else runs on the machine may spoil one or two; what the gateway does spoils all
# Wanted are 100 and 250 ms beyond the unloaded run, which `benchmarks/hostile.py` measures on a quiet
# machine. Here other work may go on, so the bounds are five times as much; what a turn of the loop
# costs is the gateway's alone, however busy the machine is.
BOUNDS = Worst(estop=500.0, gap=1000.0, health=1000.0, turn=100.0)


@pytest.fixture(scope="module")
def besieged(tmp_path_factory: pytest.TempPathFactory) -> Generator[tuple[str, Worst]]:
    """A gateway that all attacks are sent to one after the other, and its worst without any."""
    with served(tmp_path_factory.mktemp("besieged")) as url:
        yield url, asyncio.run(attacked(url, None, seconds=SHORT))


@pytest.mark.serial
@pytest.mark.parametrize("case", [case for case in CASES if not case.gap], ids=lambda c: c.name)
async def test_ten_who_send_the_dearest_requests_hold_nobody_else_up(
    besieged: tuple[str, Worst], case: Case
) -> None:
    url, calm = besieged
    over = list[dict[str, tuple[int, float]]]()
    for _ in range(ATTEMPTS):
        found = await attacked(url, case, case.who[-1], MANY, SHORT)
        beyond = Worst(*(worst - usual for worst, usual in zip(found, calm, strict=True)))
        over.append(
            {
                name: (round(getattr(beyond, name)), bound)
                for name, bound in BOUNDS._asdict().items()
                if getattr(beyond, name) > bound
            }
        )
        if not over[-1]:
            return
    raise AssertionError(over)


async def _flood(
    process: asyncio.subprocess.Process, plan: dict[str, Any], *, runs: bool
) -> set[int]:
    said, _ = await process.communicate(json.dumps(plan).encode())
    if runs:
        await asyncio.sleep(2.5)  # what was admitted runs
    return set(json.loads(said))


def _as(name: str) -> dict[str, str]:
    return {"authorization": f"Bearer {'-'.join([name] * (3 if name == 'admin' else 2))}"}
