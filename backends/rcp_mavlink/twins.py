"""Links to simulated vehicles: each runs in its own process and connects to the gateway."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from contextlib import suppress

import msgspec

from rcp_mavlink.config import LinkSpec, MavlinkConfig
from rcp_mavlink.signing import key_of

__all__ = ["STARTING", "keep_twin", "orders"]

STARTING = 20.0  # s to start one on a busy machine

_AGAIN = 1.0  # s until one that exited is restarted
_PATIENCE = 2.0  # s for one to exit by itself
_APART = 5e-5  # deg between neighbouring start positions


def orders(config: MavlinkConfig, number: int) -> dict[str, object]:
    """Return the settings of the simulated vehicle behind a link."""
    simulated = [at for at, text in enumerate(config.links) if text.startswith("sim:")]
    place = simulated.index(number)
    lat, lon, height = config.twin.home
    given = msgspec.to_builtins(config.twin)
    return given | {
        "vehicle": LinkSpec.of(config.links[number]).host,
        "system": (config.system or 1) + place,
        "home": (lat, lon + place * _APART, height),
        "key": None if config.key is None else key_of(config.key),
    }


async def keep_twin(options: dict[str, object], port: int, failed: Callable[[str], None]) -> None:
    """Keep a simulated vehicle running that connects to a loopback port, until cancelled.

    `failed` receives the reason when it exits. It exits with the gateway in any case, when its
    standard input closes.
    """
    line = msgspec.json.encode({"options": options, "links": [f"udpout:127.0.0.1:{port}"]})
    while True:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "rcp_mavlink_sim.child",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is meant for the gateway, which lands it first
        )  # fmt: skip
        assert process.stdin is not None
        assert process.stderr is not None
        try:
            process.stdin.write(line + b"\n")
            output = await process.stderr.read()
            status = await process.wait()
        finally:
            await _end(process)
        last = output.decode(errors="replace").strip().rpartition("\n")[2]
        failed(f"the simulated vehicle exited with {status}: {last}")
        await asyncio.sleep(_AGAIN)


async def _end(process: asyncio.subprocess.Process) -> None:
    assert process.stdin is not None
    process.stdin.close()
    try:
        # Not `asyncio.timeout`: in a task that is being cancelled, Python 3.11.2 raises no TimeoutError.
        await asyncio.wait_for(process.wait(), _PATIENCE)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
