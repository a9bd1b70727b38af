"""How long an e-stop, a 50 Hz pose and `/healthz` wait while hostile clients send the dearest.

The cases are those of the tests. Run: python benchmarks/hostile.py [CASE …]
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hostility.cases import CASES
from hostility.scene import Worst, attacked, served

MANY = 10  # clients at once
SECONDS = 3.0
ESTOP, GAP = 100.0, 250.0  # ms that are wanted beyond the unloaded run


def row(name: str, who: str, found: Worst, calm: Worst) -> None:
    over = found.estop - calm.estop > ESTOP or found.gap - calm.gap > GAP
    figures = "".join(f"{value:10.0f}" for value in found)
    print(f"{name:30} {who:14}{figures}  {'OVER' if over else ''}", flush=True)


async def main(wanted: list[str]) -> None:
    print(f"{'ms at worst':45}{'e-stop':>10}{'pose gap':>10}{'healthz':>10}{'CPU turn':>10}")
    calm = None
    for case in CASES:
        if wanted and case.name not in wanted:
            continue
        with TemporaryDirectory() as folder, served(Path(folder)) as url:
            if calm is None:
                calm = await attacked(url, None, seconds=SECONDS)
                row("nobody attacks", "", calm, calm)
            runs = [(who, 1) for who in case.who] + [(case.who[-1], MANY)]
            for who, clients in runs:
                found = await attacked(url, case, who, clients, SECONDS)
                row(case.name, f"{clients} {who}", found, calm)


asyncio.run(main(sys.argv[1:]))
