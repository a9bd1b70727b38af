"""A real gateway in a process of its own, with a vehicle behind a UDP port, and an operator's HTTP client."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx

from configuration import backend, key, listener, table

OPERATOR = "operator-of-the-lone-gateway"
BOUND = 60.0  # s that any wait may take: the machine may be busy
_CLOSE = 20.0  # s that it may take to end in order


class LoneGateway:
    """The process, and what an operator asks of it."""

    def __init__(self, process: asyncio.subprocess.Process, log: list[str], url: str) -> None:
        self.process, self.log = process, log
        self.http = httpx.AsyncClient(
            base_url=f"{url}/rcp/v1",
            headers={"Authorization": f"Bearer {OPERATOR}"},
            timeout=BOUND,
            trust_env=False,
        )

    def freeze(self) -> None:
        """Stop all of its threads, as they are."""
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let them go on."""
        self.process.send_signal(signal.SIGCONT)

    async def kill(self) -> None:
        """End it as a power cut would."""
        self.process.kill()
        await self.process.wait()

    async def start(self, path: str, body: Any = None) -> str:
        """Begin a command; return its id."""
        reply = await self.http.post(f"/context/tenant/alpha/{path}", json=body)
        assert reply.status_code == 202, reply.text
        return reply.headers["Location"].rpartition("/")[2]

    async def command(self, id_: str) -> dict[str, Any]:
        """Return a command as it is now."""
        return (await self.http.get(f"/commands/{id_}")).json()["body"]

    async def ended(self, id_: str) -> dict[str, Any]:
        """Wait for a command to end; return it."""
        return await self.poll(lambda: self.command(id_), lambda c: c["status"] in _FINAL)

    async def estop(self) -> dict[str, Any]:
        """Stop everything; return the final reply."""
        path = "/context/system/estop"
        reply = await self.http.post(path, params={"wait": "20", "deadline": "20"}, json={})
        return reply.json()

    async def stopped(self) -> dict[str, Any]:
        """Return how far the stop of the vehicle has come."""
        body = (await self.http.get("/context/system/estop")).json()["body"]
        (found,) = body["robots"].values()
        return found

    async def status(self) -> dict[str, Any]:
        """Return the health report."""
        return (await self.http.get("/status")).json()["body"]

    async def poll(self, ask: Callable[[], Any], holds: Callable[[Any], object]) -> Any:
        """Ask again and again until an answer is as wanted; return it."""
        found: Any = None
        try:
            async with asyncio.timeout(BOUND):
                while not holds(found := await ask()):  # noqa: ASYNC110 - of another process
                    await asyncio.sleep(0.03)
        except TimeoutError:
            raise AssertionError(f"{found!r:.3000} {self.log[-5:]}") from None
        return found

    async def guarded(self) -> None:
        """Wait until the guard is ready to stop the vehicle, and armed."""
        await self.poll(
            self.status,
            lambda s: (
                s["guard"]["state"] == "ready" and s["guard"]["armed"] and s["guard"]["plans"]
            ),
        )


_FINAL = ("completed", "failed", "rejected", "cancelled")


@asynccontextmanager
async def lone_gateway(
    folder: Path, port: int, *, safety: str = "", **options: Any
) -> AsyncGenerator[LoneGateway]:
    """Run `rcpd serve` while entered; with the same folder it has the same store."""
    config = folder / "rcp.toml"
    config.write_text(
        listener(grace=0.1)
        + table("store", path=folder / "rcp.db")
        + table("safety")
        + safety
        + backend(
            "drone",
            use="mavlink",
            links=[f"udpout:127.0.0.1:{port}"],
            params=[],
            silence=3.0,
            feedback_timeout=4.0,
            **options,
        )
        + key("operator", OPERATOR)
    )
    rcpd = Path(sys.executable).with_name("rcpd")
    process = await asyncio.create_subprocess_exec(
        rcpd, "serve", config, stderr=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.DEVNULL
    )
    log: list[str] = []
    served: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    reader = asyncio.create_task(_read(process.stderr, log, served))
    try:
        async with asyncio.timeout(BOUND):
            found = LoneGateway(process, log, await served)
        async with found.http:
            yield found
    finally:
        if process.returncode is None:
            with suppress(ProcessLookupError):  # it was killed just now
                process.send_signal(signal.SIGCONT)
                process.terminate()
            try:
                await asyncio.wait_for(process.wait(), _CLOSE)
            except TimeoutError:
                process.kill()
                await process.wait()
        reader.cancel()  # the guard has the same standard error, and may live a little longer
        await asyncio.gather(reader, return_exceptions=True)
        process._transport.close()  # noqa: SLF001 - asyncio keeps the pipe that the guard shares  # type: ignore[attr-defined]


async def _read(stream: Any, log: list[str], served: asyncio.Future[str]) -> None:
    while line := (await stream.readline()).decode():
        log.append(line)
        if "serving on " in line and not served.done():
            served.set_result(line.rpartition(" ")[2].strip())
    if not served.done():
        served.set_exception(AssertionError("rcpd did not serve: " + "".join(log)))
