"""The gateway as a node of a DroneCAN bus: it tells its state, sends messages and asks others."""

from __future__ import annotations

import asyncio
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable
from contextlib import suppress
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from rcp_can.bus import Bus, Route
from rcp_can.dronecan.library import make, type_id, type_name
from rcp_can.dronecan.node_status import OFFLINE
from rcp_can.dronecan.transfers import (
    TRANSFER_IDS,
    Assembler,
    Received,
    Service,
    encode,
    message_route,
)
from rcp_kernel.errors import DeviceTimeout, RcpError

if TYPE_CHECKING:
    import can

__all__ = ["NODE_INFO", "NODE_STATUS", "Port"]

NODE_STATUS = type_id("protocol.NodeStatus")
NODE_INFO = type_id("protocol.GetNodeInfo")
_ASKED = frozenset(
    type_id(f"protocol.{name}")
    for name in ("GetNodeInfo", "RestartNode", "param.GetSet", "param.ExecuteOpcode")
)
_NAME = "org.rcp.gateway"
_PERIOD = 1.0  # s between two reports of the own state, the longest that is allowed
_ANSWER = 0.5  # s a node has to answer
_ATTEMPTS = 3
_USUAL, _LOW = 16, 24  # priorities


class Port:
    """One per bus, with the node id of the bus's configuration."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.node = bus, bus.config.dronecan_node
        self._began = time.monotonic()
        self._sent: Counter[Hashable] = Counter()
        self._turns: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._asked: dict[tuple[int, int, int], asyncio.Future[Any]] = {}
        self._assembler = Assembler(_ASKED)
        self._doubled: float | None = None
        """When another node with the same id was last heard."""
        bus.listen(self._take, Route(0x80 | self.node << 8, 0x7F80, extended=True))
        bus.listen(self._notice_double, message_route(NODE_STATUS, self.node))

    def broadcast(
        self,
        payload: Any,
        *,
        priority: int = _USUAL,
        lifetime: float | None = None,
        urgent: bool = False,
        sender: Hashable = None,
    ) -> None:
        """Send a message to all nodes; the rest is as in `Bus.send`.

        :raises AdapterUnavailable: the bus is down, or off.
        :raises QueueFull: the send queue is full.
        """
        if urgent:
            # What waits is dropped for it. A receiver takes a transfer of several frames that comes
            # one number late for a part of another; one that comes two or more late it begins anew.
            self._sent[type_name(payload), None] += 2
        frames = self._frames(payload, priority, None)
        self.bus.send_together(frames, lifetime=lifetime, urgent=urgent, sender=sender)

    async def request(
        self,
        node: int,
        payload: Any,
        what: str,
        *,
        attempts: int = _ATTEMPTS,
        before: Callable[[], None] = lambda: None,
    ) -> Any:
        """Ask a node, again if it does not answer, and return its response.

        One request of a node waits for the other: transfers have only 32 numbers. `before` is called
        right before it is sent, and raises to refuse it.

        :raises DeviceTimeout: no answer arrives.
        :raises AdapterUnavailable: the bus is down, or off.
        """
        async with self._turns[node]:
            before()
            return await self._request(node, payload, what, attempts)

    async def _request(self, node: int, payload: Any, what: str, attempts: int) -> Any:
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        keys: list[tuple[int, int, int]] = []
        try:
            for _ in range(attempts):
                frames = self._frames(payload, _USUAL, Service(node, request=True))
                number = frames[-1][1][-1] % TRANSFER_IDS
                keys.append((node, frames[0][0] >> 16 & 0xFF, number))
                self._asked[keys[-1]] = answer
                self.bus.send_together(frames)
                await asyncio.wait((answer,), timeout=_ANSWER)
                if answer.done():
                    return answer.result()
        finally:
            for key in keys:
                self._asked.pop(key, None)
        raise DeviceTimeout(
            f"DroneCAN node {node} did not answer {what}",
            remedy="Check its node id and supply; a node answers nothing without an id of its own.",
        )

    async def run(self) -> None:
        """Report the own state until cancelled."""
        while True:
            self._forget_double()
            with suppress(RcpError):  # the bus state reports it
                self.broadcast(self._status(), priority=_LOW)
            await asyncio.sleep(_PERIOD)

    def _frames(
        self, payload: Any, priority: int, service: Service | None
    ) -> list[tuple[int, bytes]]:
        kind = type_name(payload), service
        number = self._sent[kind] % TRANSFER_IDS
        self._sent[kind] += 1
        return encode(
            payload, source=self.node, transfer_id=number, priority=priority, service=service
        )

    def _status(self) -> Any:
        return make("protocol.NodeStatus", uptime_sec=int(time.monotonic() - self._began))

    def _take(self, message: can.Message) -> None:
        received = self._assembler.take(message)
        if received is None or received.service is None:
            return
        if received.service.request:
            if received.type_id == NODE_INFO:
                self._answer(received)
            return
        asked = self._asked.get((received.source, received.type_id, received.transfer_id))
        if asked is not None and not asked.done():
            asked.set_result(received.payload)

    def _answer(self, request: Received) -> None:
        """Tell what the gateway is."""
        major, minor, *_ = (int(part) for part in version("rcp-gateway").split(".")[:2])
        info = make("protocol.GetNodeInfo.Response", name=_NAME, status=self._status())
        info.software_version.major, info.software_version.minor = major, minor
        frames = encode(
            info,
            source=self.node,
            transfer_id=request.transfer_id,
            priority=_USUAL,
            service=Service(request.source, request=False),
        )
        with suppress(RcpError):  # whoever asked will ask again
            self.bus.send_together(frames)

    def _notice_double(self, message: can.Message) -> None:
        text = (
            f"another node of CAN bus '{self.bus.name}' has the gateway's DroneCAN id {self.node}:"
            " give the bus another `dronecan_node`, or that node another id"
        )
        self._doubled = time.monotonic()
        self.bus.health.report(f"dronecan {self.bus.name}", text)

    def _forget_double(self) -> None:
        if self._doubled is not None and time.monotonic() - self._doubled > OFFLINE:
            self._doubled = None
            self.bus.health.report(f"dronecan {self.bus.name}", None)
