"""An asynchronous SDO client with expedited and segmented transfers (CiA 301, 7.2.4)."""

from __future__ import annotations

import asyncio
import struct
import time
from typing import TYPE_CHECKING

from rcp_can.bus import Bus, Route
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["ABORTS", "Sdo", "SdoAborted"]

_TIMEOUT = 0.5  # s for one response
_MOST_OWED = 8
_OWES = 5.0  # s within which a busy node answers what was given up
_LONGEST = 65_536  # bytes: the longest value accepted
_TIMED_OUT = 0x05040000
_UPLOADED, _DOWNLOADED, _SEGMENT_UP, _SEGMENT_DOWN, _ABORTED = 0x40, 0x60, 0x00, 0x20, 0x80
"""Command specifiers of a server (CiA 301, 7.2.4.3), the top three bits of a response."""
_INITIATED = frozenset((_UPLOADED, _DOWNLOADED))  # these have an index and a sub-index

ABORTS = {
    0x05030000: "toggle bit not alternated",
    _TIMED_OUT: "SDO protocol timed out",
    0x05040001: "command specifier not valid or unknown",
    0x05040005: "out of memory",
    0x06010000: "unsupported access",
    0x06010001: "the object is write-only",
    0x06010002: "the object is read-only",
    0x06020000: "the object does not exist",
    0x06040041: "the object cannot be mapped to the PDO",
    0x06040042: "the PDO would be longer than 8 bytes",
    0x06040043: "general parameter incompatibility",
    0x06060000: "access failed due to a hardware error",
    0x06070010: "the length does not match the data type",
    0x06070012: "the data is too long",
    0x06070013: "the data is too short",
    0x06090011: "the sub-index does not exist",
    0x06090030: "the value is out of range",
    0x06090031: "the value is too high",
    0x06090032: "the value is too low",
    0x08000000: "general error",
    0x08000020: "data cannot be stored",
    0x08000021: "data cannot be stored: local control",
    0x08000022: "data cannot be stored in this device state",
}


class SdoAborted(DeviceRejected):
    """The node aborted an access, with an abort code of CiA 301."""

    def __init__(self, node: int, index: int, sub: int, abort: int) -> None:
        why = ABORTS.get(abort, "unknown reason")
        super().__init__(
            f"node {node} refused 0x{index:04X}:{sub:02X}: {why} (0x{abort:08X})",
            details={"index": index, "subindex": sub, "abort": abort},
        )
        self.abort = abort


class Sdo:
    """The SDO client of one node; one access at a time."""

    def __init__(self, bus: Bus, node: int) -> None:
        self.unasked = 0
        """Number of duplicate responses to one request, a sign of two nodes with one id."""
        self._bus, self._node = bus, node
        self._lock = asyncio.Lock()
        self._answer: asyncio.Future[bytes] | None = None
        self._expected = b""
        """Index and sub-index of the pending request."""
        self._specifier = 0
        """The command specifier of its response."""
        self._mismatched = False
        """Whether a response to another request arrived meanwhile."""
        self._last = b"", float("-inf")
        """The previous response, and when it arrived."""
        self._owed = 0
        """Responses to requests that were given up: a busy node answers them later, one by one."""
        self._owed_at = float("-inf")
        """When the last of them was given up."""

    @property
    def route(self) -> Route:
        """The identifier of the responses."""
        return Route(0x580 + self._node)

    @property
    def busy(self) -> bool:
        """Whether an access is in progress."""
        return self._lock.locked()

    def take(self, message: can.Message) -> None:
        """Handle a response.

        :raises ValueError: the response is too short.
        """
        if len(message.data) < 8:
            raise ValueError("an SDO response has 8 bytes")
        data, now = bytes(message.data), time.monotonic()
        again = data[:4] == self._last[0][:4] and now - self._last[1] < _TIMEOUT
        if again and data[1:4] != self._expected:
            if self._owed and now - self._owed_at < _OWES:
                self._owed -= 1
            else:
                self._owed = 0
                self.unasked += 1
        elif self._answer is not None and not self._answer.done():
            if not self._matches(data):  # late, of another node with this id, or to another master
                self._mismatched = True
                return
            self._answer.set_result(data)
            self._last = data, now
            self._expected = b""

    def _matches(self, data: bytes) -> bool:
        """Return whether a response is one to the pending request, as far as it tells."""
        specifier = data[0] & 0xE0
        if specifier == _ABORTED:
            return data[1:4] in (self._expected, b"\0\0\0")
        return specifier == self._specifier and (
            specifier not in _INITIATED or data[1:4] == self._expected
        )

    async def upload(self, index: int, sub: int = 0) -> bytes:
        """Read an object.

        :raises SdoAborted: the node refuses.
        :raises DeviceTimeout: the node does not respond.
        """
        async with self._lock:
            frame = struct.pack("<BHBxxxx", 0x40, index, sub)
            head = await self._request(frame, _UPLOADED, index, sub)
            if head[0] & 2:
                size = 4 - (head[0] >> 2 & 3) if head[0] & 1 else 4
                return head[4 : 4 + size]
            data, toggle = b"", 0
            while True:
                frame = bytes((0x60 | toggle,)).ljust(8, b"\0")
                part = await self._request(frame, _SEGMENT_UP, index, sub)
                if part[0] & 0xF0 != toggle:
                    await self._abort(index, sub, 0x05030000)
                data += part[1 : 8 - (part[0] >> 1 & 7)]
                if part[0] & 1:
                    return data
                if len(data) > _LONGEST:
                    await self._abort(index, sub, 0x05040005)
                toggle ^= 0x10

    async def download(
        self, index: int, sub: int, data: bytes, *, seconds: float = _TIMEOUT
    ) -> None:
        """Write an object; `seconds` is the time for the response, for a value of up to four bytes.

        :raises SdoAborted: the node refuses.
        :raises DeviceTimeout: the node does not respond.
        """
        async with self._lock:
            if 0 < len(data) <= 4:
                command = 0x23 | (4 - len(data)) << 2
                frame = struct.pack("<BHB", command, index, sub) + data.ljust(4, b"\0")
                await self._request(frame, _DOWNLOADED, index, sub, seconds)
                return
            frame = struct.pack("<BHBI", 0x21, index, sub, len(data))
            await self._request(frame, _DOWNLOADED, index, sub)
            toggle = 0
            for start in range(0, max(len(data), 1), 7):
                part = data[start : start + 7]
                last = start + 7 >= len(data)
                command = toggle | (7 - len(part)) << 1 | last
                frame = bytes((command,)) + part.ljust(7, b"\0")
                answer = await self._request(frame, _SEGMENT_DOWN, index, sub)
                if answer[0] & 0xF0 != 0x20 | toggle:
                    await self._abort(index, sub, 0x05030000)
                toggle ^= 0x10

    async def _abort(self, index: int, sub: int, code: int) -> None:
        self._bus.send(0x600 + self._node, struct.pack("<BHBI", 0x80, index, sub, code))
        raise SdoAborted(self._node, index, sub, code)

    async def _request(
        self, frame: bytes, specifier: int, index: int, sub: int, seconds: float = _TIMEOUT
    ) -> bytes:
        """Send a request; return the response to it, whatever else arrives before."""
        self._answer = asyncio.get_running_loop().create_future()
        self._expected, self._specifier = struct.pack("<HB", index, sub), specifier
        self._mismatched = False
        try:
            self._bus.send(0x600 + self._node, frame)
            # Neither `wait_for`, which may swallow a cancellation, nor `asyncio.timeout`: in a task that
            # is being cancelled, Python 3.11.2 raises no TimeoutError.
            done, _ = await asyncio.wait((self._answer,), timeout=seconds)
            if not done:
                raise TimeoutError
            answer = self._answer.result()
        except TimeoutError:
            now = time.monotonic()
            owed = self._owed if now - self._owed_at < _OWES else 0
            self._owed, self._owed_at = min(owed + 1, _MOST_OWED), now
            if self._bus.up:
                self._bus.send(
                    0x600 + self._node, struct.pack("<BHBI", 0x80, index, sub, _TIMED_OUT)
                )
                raise self._late(index, sub) from None
            raise AdapterUnavailable(f"CAN bus '{self._bus.name}' is {self._bus.state}") from None
        finally:
            self._answer = None
        if answer[0] & 0xE0 == _ABORTED:
            raise SdoAborted(self._node, index, sub, int.from_bytes(answer[4:8], "little"))
        return answer

    def _late(self, index: int, sub: int) -> DeviceTimeout:
        text = f"node {self._node} did not respond for 0x{index:04X}:{sub:02X}"
        if not self._mismatched:
            return DeviceTimeout(text)
        return DeviceTimeout(
            f"{text}, but to another request",
            remedy="Check for another master on this bus, or another node with this id.",
        )
