"""Control of one vehicle by a ground station: a lease while it commands, and its frames in order."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec
import structlog

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_ground_stations.answers import Refusal
from rcp_ground_stations.config import StationConfig
from rcp_ground_stations.stops import Stop, stop_of
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request
from rcp_mavlink.forwarding import asks_only
from rcp_mavlink.frames import Frame, rebuilt
from rcp_protocol.task_groups import TaskGroup
from rcp_protocol.timeouts import timeout

__all__ = ["Pilot"]

log = structlog.get_logger("rcp.ground_stations")
_LEASES = "/system/leases"
_MOST = 512  # frames that wait
_TTL = 6.0  # s of the lease, from its last renewal
_RENEW = 2.0  # s
_SETPOINTS = frozenset({
    "MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE", "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED",
})  # fmt: skip
_REASON = "flies with a ground station"
_OVERTAKEN = Refusal("cancelled", True, {})
_UNCONTROLLED = ("lease_lost", "lease_required")
"""Refusals of a write that a lease of its own would allow."""


class Pilot:
    """Passes frames on; `refused` is told of those that went no further."""

    def __init__(
        self,
        config: StationConfig,
        client_api: ClientApi,
        session: Session,
        refused: Callable[[Frame, Refusal], None],
    ) -> None:
        self._config, self._client_api = config, client_api
        self.session = session
        self._refused = refused
        self._send = config.path("actuator", "mavlink/frame")
        self._ask = config.path("service", "mavlink/ask")
        self._waiting: deque[tuple[Frame, float]] = deque()
        """Frames, and when they came, in seconds since the epoch."""
        self._stops: dict[Stop, Frame] = {}
        """Stops that wait, the newest of a kind."""
        self._stopped = 0
        """Stops that have come: what came before one must not reach the vehicle after it."""
        self._room, self._stopping = asyncio.Event(), asyncio.Event()
        self._lease: str | None = None
        self._renewed = self._commanded = float("-inf")

    def take(self, frame: Frame) -> None:
        """Pass a frame on in its turn; a set-point takes the place of an older one, a stop of all commands."""
        if (stop := stop_of(frame)) is not None:
            self._stop(stop, frame)
            return
        kind = frame.definition.name
        if kind in _SETPOINTS:
            for waiting in [*self._waiting]:
                if (waiting[0].definition.name, waiting[0].system) == (kind, frame.system):
                    self._waiting.remove(waiting)
        if len(self._waiting) >= _MOST:
            self._refused(frame, Refusal("queue_full", True, {}))
            return
        self._waiting.append((frame, time.time()))
        self._room.set()

    def _stop(self, stop: Stop, frame: Frame) -> None:
        """Pass a stop on at once; what moves and still waits would undo it."""
        self._stopped += 1
        overtaken = [one for one, _ in self._waiting if not asks_only(one)]
        self._waiting = deque(one for one in self._waiting if asks_only(one[0]))
        for one in overtaken:
            self._refused(one, _OVERTAKEN)
        self._stops.pop(stop, None)
        self._stops[stop] = frame
        self._stopping.set()

    async def run(self) -> None:
        """Pass frames on, and give control back when there are no more commands, until cancelled."""
        async with TaskGroup() as group:
            group.create_task(self._pass_stops())
            group.create_task(self._pass_all())

    async def _pass_stops(self) -> None:
        """Pass stops on, beside the frames that may wait for the vehicle."""
        while True:
            await self._stopping.wait()
            self._stopping.clear()
            while self._stops:
                frame = self._stops.pop(next(iter(self._stops)))
                await self._safely(self._pass_stop(frame))

    async def _pass_all(self) -> None:
        while True:
            while self._waiting:
                await self._safely(self._pass(*self._waiting.popleft()))
                await self._safely(self._keep())
            self._room.clear()
            try:
                async with timeout(_RENEW):
                    await self._room.wait()
            except TimeoutError:
                await self._safely(self._keep())

    async def _safely(self, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except Exception:  # of one frame: the next one may be to stop
            log.exception("frame_failed")

    async def _pass(self, frame: Frame, came: float) -> None:
        """Pass a frame on, with control if it does something."""
        data, stopped = _unsigned(frame), self._stopped
        if asks_only(frame):
            self._answer(frame, await self._request("execute", self._ask, {"data": data}))
            return
        refusal = await self._control()
        if refusal is None and self._stopped != stopped:
            refusal = _OVERTAKEN
        if refusal is None:
            # Sticks of a while ago move nothing: the gateway refuses what has waited too long.
            refusal = await self._write(data, came)
        self._answer(frame, refusal)

    async def _pass_stop(self, frame: Frame) -> None:
        """Pass a stop on, of whatever age; it asks for control only if it is refused without."""
        data = _unsigned(frame)
        refusal = await self._write(data, None)
        if refusal is not None and refusal.code in _UNCONTROLLED:
            self._lease = None
            refusal = await self._control() or await self._write(data, None)
        self._answer(frame, refusal)

    async def _write(self, data: bytes, came: float | None) -> Refusal | None:
        self._commanded = self._now()
        return await self._request("write", self._send, {"data": data}, came)

    def _answer(self, frame: Frame, refusal: Refusal | None) -> None:
        if refusal is None:
            return
        if refusal.code.startswith("lease_") or refusal.code == "estop_active":
            self._lease = None
        self._refused(frame, refusal)

    async def _control(self) -> Refusal | None:
        """Take control, or keep it; return why somebody else has it."""
        if self._lease is not None and self._now() - self._renewed < _RENEW:
            return None
        reply = await self._client_api.request(
            self.session,
            _request(
                "execute",
                _LEASES,
                {"do": "acquire", "scope": self._config.robot, "ttl": _TTL, "reason": _REASON},
            ),
        )
        if reply.error is not None:
            self._lease = None
            return Refusal.of(reply.error)
        self._lease = msgspec.to_builtins(getattr(reply.body, "value", reply.body))["lease"]
        self._renewed = self._now()
        return None

    async def _keep(self) -> None:
        """Renew the lease while there are commands; release it after the last."""
        now = self._now()
        if self._lease is None or now - self._renewed < _RENEW:
            return
        if now - self._commanded >= self._config.hold:
            await self.release()
            return
        # Not acquired again: what somebody took, or a stop ended, is asked for by a command alone.
        renewal = {"do": "renew", "lease": self._lease, "ttl": _TTL}
        if await self._request("execute", _LEASES, renewal) is None:
            self._renewed = now
        else:
            self._lease = None

    async def release(self) -> None:
        """Give control back."""
        lease, self._lease = self._lease, None
        if lease is not None:
            await self._request("execute", _LEASES, {"do": "release", "lease": lease})

    async def _request(
        self, type_: Any, path: str, body: dict[str, Any], came: float | None = None
    ) -> Refusal | None:
        reply = await self._client_api.request(self.session, _request(type_, path, body, came))
        return None if reply.error is None else Refusal.of(reply.error)

    def _now(self) -> float:
        return self._client_api.loop.time()


def _unsigned(frame: Frame) -> bytes:
    """Return its bytes: who signed it for the gateway is no affair of the vehicle's."""
    return rebuilt(frame, None, 0)


def _request(type_: Any, path: str, body: dict[str, Any], came: float | None = None) -> Request:
    return Request(
        type=type_,
        path=path,
        timestamp=came,
        body=msgspec.Raw(msgspec.msgpack.encode(body)),
        encoding=Encoding.MSGPACK,
    )
