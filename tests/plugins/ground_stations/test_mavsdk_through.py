"""MAVSDK, unchanged, at a simulated copter through the gateway, with a real gateway in this process."""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from browser.robots import until
from configuration import backend, key, listener, role, rule, table
from ports import free_port
from rcp_gateway.log import configure
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse
from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Framer
from rcp_mavlink.signing import Signing, key_of

pytestmark = pytest.mark.anyio
FLIGHTS = Path(__file__).parents[2] / "backends" / "mavlink" / "mavsdk_flights.py"
MESSAGES = dialect("ardupilotmega")
BOUND = 150.0  # s
ADMIN, PILOT, LOOKER = (f"a-key-of-the-{who}-which-is-long" for who in ("admin", "pilot", "looker"))
FRAMES = "/mavlink/frame"


class Gateway:
    """A copter behind a gateway, and where MAVSDK attaches."""

    def __init__(self, url: str, ports: dict[str, int]) -> None:
        self.ports = ports
        headers = {"authorization": f"Bearer {ADMIN}"}
        self.http = httpx.AsyncClient(base_url=url, headers=headers, timeout=60)

    async def execute(self, path: str, body: Any) -> dict[str, Any]:
        """Execute something as the administrator."""
        message = {"type": "execute", "path": path, "body": body}
        answer = (await self.http.post("/rcp/v1/messages", json=message)).json()
        assert answer["status"] == "completed", answer
        return answer["body"]

    async def leases(self, holds: Any) -> list[dict[str, Any]]:
        """Wait for leases to be as wanted."""
        return await until(self.http, "/system/leases", holds)


@asynccontextmanager
async def gateway(**more: Any) -> AsyncGenerator[Gateway]:
    """Run a gateway with a simulated copter and two links for ground stations."""
    configure("error", "json")
    ports = {"pilot": free_port(), "looker": free_port()}
    text = (
        listener()
        + backend(
            "drone", use="mavlink", links=["sim:copter"], forward=True,
            twin={"speed": 8.0, "warmup": 20.0},
        )
        + key("admin", ADMIN) + key("pilot", PILOT, role="operator") + key("looker", LOOKER)
        + role(
            "looker",
            rule("discover read subscribe", "/**"),
            rule("execute", "/service/mavlink/ask"),
        )
        + table(
            "plugins.ground_stations.stations.pilot",
            link=f"udpin:127.0.0.1:{ports['pilot']}", robot="/tenant/alpha", token=PILOT, **more,
        )
        + table(
            "plugins.ground_stations.stations.looker",
            link=f"udpin:127.0.0.1:{ports['looker']}", robot="/tenant/alpha", token=LOOKER,
        )
    )  # fmt: skip
    async with serve(parse(text, "test")) as served:
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        made = Gateway(url, ports)
        try:
            await until(made.http, "/tenant/alpha/sensor/pose", bool, 60.0)
            yield made
        finally:
            await made.http.aclose()


class Flight:
    """MAVSDK in a process of its own."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._text = ""

    async def line(self, word: str) -> str:
        """Wait for a line with a word."""
        assert self._process.stdout is not None
        async with asyncio.timeout(BOUND):
            while line := (await self._process.stdout.readline()).decode():
                self._text += line
                if word in line:
                    return line
        raise AssertionError(f"no {word!r} in:\n{self._text[-3000:]}")

    async def ended(self) -> None:
        """Wait for its end, which has to be a good one."""
        assert self._process.stdout is not None
        async with asyncio.timeout(BOUND):
            self._text += (await self._process.stdout.read()).decode()
            assert await self._process.wait() == 0, self._text[-3000:]


@asynccontextmanager
async def flight(name: str, port: int, folder: Path) -> AsyncGenerator[Flight]:
    """Let MAVSDK fly while entered."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, FLIGHTS, name, str(port), str(folder),
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
    )  # fmt: skip
    try:
        yield Flight(process)
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def test_mavsdk_flies_and_keeps_parameters_missions_and_files_as_without_a_gateway(
    tmp_path: Path,
) -> None:
    async with gateway() as made:
        for name in (
            "reads_and_sets_parameters",
            "uploads_a_mission_and_reads_it_back",
            "keeps_files_and_fences",
            "arms_takes_off_goes_returns_and_lands",
        ):
            async with flight(name, made.ports["pilot"], tmp_path) as flown:
                await flown.ended()


async def test_who_has_control_is_asked_first_and_mavsdk_flies_when_it_is_yielded(
    tmp_path: Path,
) -> None:
    async with gateway() as made:
        held = {"do": "acquire", "scope": "/tenant/alpha/actuator", "ttl": 120}
        lease = await made.execute("/system/leases", held)
        async with flight("flies_once_it_may", made.ports["pilot"], tmp_path) as flown:
            assert "DENIED" in await flown.line("refused")
            await flown.line("refused")
            armed = (await made.http.get("/rcp/v1/context/tenant/alpha/sensor/armed")).json()
            assert armed["body"] is False
            await made.execute("/system/leases", {"do": "release", "lease": lease["lease"]})
            await flown.line("flies")
            (now,) = await made.leases(bool)
            assert now["holder"] == "pilot"
            # What somebody else commands is refused now, and a stop is not.
            goal = {"type": "execute", "path": "/tenant/alpha/action/land", "body": None}
            answer = (await made.http.post("/rcp/v1/messages", json=goal)).json()
            assert answer["error"]["code"] == "lease_held"
            await made.execute("/system/estop", {"reason": "test"})
            await made.leases(lambda found: not found)
            robots = await until(
                made.http,
                "/system/estop",
                lambda found: found["robots"]["drone"]["state"] == "confirmed",
                60.0,
            )
            assert robots["active"]


async def test_who_may_only_look_sees_all_and_moves_nothing(tmp_path: Path) -> None:
    async with gateway() as made:
        async with flight("flies_once_it_may", made.ports["looker"], tmp_path) as flown:
            assert "DENIED" in await flown.line("refused")
        armed = (await made.http.get("/rcp/v1/context/tenant/alpha/sensor/armed")).json()
        assert armed["body"] is False
        await made.leases(lambda found: not found)


async def test_a_stop_holds_against_a_ground_station(tmp_path: Path) -> None:
    async with gateway() as made:
        await made.execute("/system/estop", {"reason": "test"})
        async with flight("flies_once_it_may", made.ports["pilot"], tmp_path) as flown:
            await flown.line("refused")
            await flown.line("refused")
            armed = (await made.http.get("/rcp/v1/context/tenant/alpha/sensor/armed")).json()
            assert armed["body"] is False
            await made.execute("/system/estop", {"reset": True})
            await flown.line("flies")
        await made.leases(lambda found: not found)  # it gives control back when it is silent


class Signer:
    """A ground station that signs; as the sink of pymavlink it sends what it is given."""

    def __init__(self, port: int, key: str) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(1.0)
        self._framer = Framer(MESSAGES, Signing(key_of(key)))
        self._mav = MESSAGES.module.MAVLink(self, 245, 190)
        Signing(key_of(key)).apply(self._mav, 0)

    def write(self, data: bytes) -> None:
        """Send a frame."""
        self._socket.send(bytes(data))

    def heard(self) -> bool:
        """Send a heartbeat, and return whether a frame with the right signature has come."""
        self._mav.heartbeat_send(6, 8, 0, 0, 4)
        with suppress(TimeoutError):
            return bool(self._framer.datagram(self._socket.recv(2000)))
        return False

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


async def test_a_signed_link_tells_strangers_nothing() -> None:
    async with gateway(key="a secret of the station") as made:
        port = made.ports["pilot"]
        with (
            closing(Signer(port, "a secret of the station")) as station,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
        ):
            stranger.setblocking(False)
            stranger.sendto(b"let me in", ("127.0.0.1", port))
            async with asyncio.timeout(60):
                while not await asyncio.to_thread(station.heard):
                    pass
            with pytest.raises(BlockingIOError):
                stranger.recv(300)
