"""How long an e-stop, a 50 Hz pose and `/healthz` wait while hostile clients send the dearest.

The cases are those of the tests. Run: python benchmarks/hostile.py [CASE …], or `--list` for their names.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hostility.cases import CASES, Case
from hostility.scene import Worst, attacked, served

MANY = 10  # clients at once
SECONDS = 1.5  # of each attack: a run of all cases takes less than ten minutes
ESTOP, GAP = 100.0, 250.0  # ms that are wanted beyond the unloaded run
COLUMNS = ("e-stop", "beyond", "pose gap", "beyond", "healthz", "CPU turn")


def row(name: str, who: str, found: Worst, calm: Worst) -> None:
    estop, gap = found.estop - calm.estop, found.gap - calm.gap
    figures = (found.estop, estop, found.gap, gap, found.health, found.turn)
    said = "OVER" if estop > ESTOP or gap > GAP else ""
    print(f"{name:42} {who:14}" + "".join(f"{value:9.0f}" for value in figures), said, flush=True)


def chosen(names: Sequence[str]) -> list[Case]:
    """Return the cases that are named, or all; ends with the names where one is none."""
    known = {case.name: case for case in CASES}
    if unknown := [name for name in names if name not in known]:
        sys.exit(f"no case {unknown}; there are:\n" + "\n".join(known))
    return [known[name] for name in names or known]


async def main(cases: list[Case]) -> None:
    print(f"{'ms at worst':57}" + "".join(f"{name:>9}" for name in COLUMNS))
    calm = None
    for case in cases:
        with TemporaryDirectory() as folder, served(Path(folder)) as url:
            if calm is None:
                calm = await attacked(url, None, seconds=SECONDS)
                row("nobody attacks", "", calm, calm)
            runs = [(who, 1) for who in case.who] + [(case.who[-1], MANY)]
            for who, clients in runs:
                try:
                    found = await attacked(url, case, who, clients, SECONDS)
                except AssertionError as failed:
                    print(f"{case.name:42} {clients} {who}: {failed}", flush=True)
                else:
                    row(case.name, f"{clients} {who}", found, calm)


if sys.argv[1:] == ["--list"]:
    print("\n".join(case.name for case in CASES))
else:
    asyncio.run(main(chosen(sys.argv[1:])))
