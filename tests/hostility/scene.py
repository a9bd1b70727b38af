"""Gateway, attackers and watcher, each a process: the gateway has a core, the others share one."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from hostility.cases import Case, Who

__all__ = ["Worst", "attacked", "served"]

_HERE = Path(__file__).parent
_BEGUN = 60.0  # s until the first answer to an attack


class Worst(NamedTuple):
    """Milliseconds."""

    estop: float
    """Until an e-stop was answered."""
    gap: float
    """Between two poses of a 50 Hz subscription."""
    health: float
    """Until `/healthz` was answered."""
    turn: float
    """Of the processor, for one turn of the gateway's loop."""


@contextmanager
def served(folder: Path) -> Generator[str]:
    """Run the gateway on a core of its own while entered; yield its address."""
    with (
        (folder / "log").open("w") as log,
        subprocess.Popen(
            [sys.executable, _HERE / "world.py", folder],
            env={**os.environ, "PYTHONPATH": str(_HERE.parent)},
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        ) as process,
    ):
        try:
            os.sched_setaffinity(process.pid, _cores()[0])
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.kill()


async def attacked(
    url: str, case: Case | None, who: Who = "anonymous", clients: int = 1, seconds: float = 2.0
) -> Worst:
    """Return the worst that a client beside the attackers noticed; None: there were none."""
    if case is None:
        return await _watched(url, seconds)
    attacker = await asyncio.create_subprocess_exec(
        *(sys.executable, _HERE / "attack.py", url, case.name, who, str(clients)),
        stdout=asyncio.subprocess.PIPE,
        preexec_fn=_beside,
    )
    try:
        watching = asyncio.create_task(_watched(url, seconds))
        assert attacker.stdout is not None
        async with asyncio.timeout(_BEGUN + seconds):
            begun = await attacker.stdout.readline()
        found = await watching
    finally:
        attacker.kill()
        await attacker.wait()
    if not begun:
        raise AssertionError(f"the attackers of {case.name!r} ended")
    return found


async def _watched(url: str, seconds: float) -> Worst:
    watcher = await asyncio.create_subprocess_exec(
        *(sys.executable, _HERE / "watch.py", url, str(seconds)),
        stdout=asyncio.subprocess.PIPE,
        preexec_fn=_beside,
    )
    output, _ = await watcher.communicate()
    if watcher.returncode:
        raise AssertionError("a client beside the attackers was refused, or waited too long")
    return Worst(*json.loads(output))


def _cores() -> tuple[set[int], set[int]]:
    """Return the gateway's core, and those of all others."""
    found = sorted(os.sched_getaffinity(0))
    return {found[0]}, set(found[1:]) or {found[0]}


def _beside() -> None:
    os.sched_setaffinity(0, _cores()[1])
