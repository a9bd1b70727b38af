"""MAVLink FTP client: requests, bursts, and retransmission of gaps."""

from __future__ import annotations

import asyncio
import os
import struct
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import NamedTuple

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    NotImplementedByRobot,
    RcpError,
)
from rcp_mavlink.frames import Frame
from rcp_mavlink.gaps import Gaps
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.task_groups import TaskGroup
from rcp_protocol.timeouts import timeout

__all__ = ["PIECE", "Ftp", "Op", "Reply"]

PIECE = 239
"""Bytes of data in one message."""
_HEAD = struct.Struct("<HBBBBBxI")
_ACK, _NAK = 128, 129
_AT_ONCE = 4  # chunks written but not yet acknowledged
_LATE = 4096  # chunks that may still arrive after a burst is abandoned
_BURST_FROM = 4 * PIECE  # bytes above which a burst is worthwhile
_END_OF_FILE, _ERRNO, _NO_SESSION, _UNKNOWN = 6, 2, 5, 7
_EXISTS, _NOT_FOUND = 8, 10
_WORDS = {
    1: "failed", 2: "failed", 3: "invalid size", 4: "no such session", 5: "no free session",
    6: "end of file", 7: "not supported", 8: "it already exists", 9: "it is write-protected",
    10: "no such file or directory",
}  # fmt: skip
_ENOENT, _EEXIST = 2, 17
_PATIENT = 15  # requests for an operation that takes long


class Op:
    """Opcodes of requests."""

    TERMINATE, RESET, LIST, OPEN_TO_READ, READ, CREATE, WRITE, REMOVE = range(1, 9)
    MAKE_DIRECTORY, REMOVE_DIRECTORY, OPEN_TO_WRITE, _TRUNCATE, RENAME, CRC, BURST = range(9, 16)


class Reply(NamedTuple):
    """One reply of the vehicle."""

    seq: int
    session: int
    opcode: int
    request_opcode: int
    complete: bool
    """Whether it is the last message of a burst."""
    offset: int
    data: bytes

    @classmethod
    def of(cls, payload: bytes) -> Reply:
        """Parse a payload."""
        seq, session, opcode, size, request_opcode, complete, offset = _HEAD.unpack_from(payload)
        return cls(
            seq, session, opcode, request_opcode, bool(complete), offset, payload[12 : 12 + size]
        )

    @property
    def error(self) -> int:
        """The error code of a refusal; 0 for none."""
        if self.opcode != _NAK:
            return 0
        code = self.data[0] if self.data else 1
        if code == _ERRNO and len(self.data) > 1:
            return {_ENOENT: _NOT_FOUND, _EEXIST: _EXISTS}.get(self.data[1], code)
        return code


class Ftp:
    """The files of one component, the autopilot if none is given; one transfer at a time."""

    def __init__(self, hub: Hub, vehicle: Vehicle, component: int | None = None) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._component = vehicle.component if component is None else component
        self._turn = asyncio.Lock()
        self._seq = 0
        self._waiting: dict[tuple[int, int], asyncio.Future[Reply]] = {}
        """By number and opcode: late chunks of a burst can carry the numbers of other replies."""
        self._burst: Callable[[Reply], None] | None = None

    @asynccontextmanager
    async def turn(self) -> AsyncGenerator[None]:
        """Lock the vehicle's FTP while entered."""
        async with self._turn:
            apart = self._component != self._vehicle.component
            with self._vehicle.listening("FILE_TRANSFER_PROTOCOL", self._take, anybody=apart):
                yield

    def _take(self, frame: Frame) -> None:
        if frame.component != self._component:
            return
        fields = frame.fields()
        if fields["target_system"] not in (0, self._hub.config.source_system):
            return
        reply = Reply.of(bytes(fields["payload"]))
        if reply.opcode not in (_ACK, _NAK):
            return
        waiting = self._waiting.get((reply.seq, reply.request_opcode))
        if waiting is not None and not waiting.done():
            waiting.set_result(reply)
        elif reply.request_opcode == Op.BURST and self._burst is not None:
            self._burst(reply)

    def _send(self, seq: int, op: int, session: int, offset: int, data: bytes, size: int) -> None:
        head = _HEAD.pack(seq, session, op, size, 0, 0, offset)
        vehicle = self._vehicle
        message = self._hub.dialect.module.MAVLink_file_transfer_protocol_message(
            0, vehicle.system, self._component, (head + data).ljust(251, b"\0")
        )
        self._hub.send(vehicle, message)

    def _next(self) -> int:
        """Return the next sequence number; the reply has the following one."""
        self._seq = (self._seq + 2) & 0xFFFF
        return self._seq

    async def request(
        self,
        op: int,
        session: int = 0,
        offset: int = 0,
        data: bytes = b"",
        *,
        size: int | None = None,
        wait: float = 0.0,
    ) -> Reply:
        """Send a request until a reply arrives, always with the same sequence number.

        :raises DeviceTimeout: the vehicle does not respond.
        """
        config, seq = self._hub.config, self._next()
        pause = max(wait, config.timeout)
        rounds = _PATIENT if wait else config.retries + 1
        wanted = (seq + 1) & 0xFFFF, op
        waiting = self._waiting[wanted] = asyncio.get_running_loop().create_future()
        try:
            for _ in range(rounds):
                self._vehicle.check()
                self._send(seq, op, session, offset, data, len(data) if size is None else size)
                done, _pending = await asyncio.wait({waiting}, timeout=pause)
                if done:
                    return waiting.result()
        finally:
            del self._waiting[wanted]
        self._vehicle.check()
        raise DeviceTimeout(
            "the vehicle did not respond over FTP",
            remedy="Check sensor/links; a vehicle without FTP never responds.",
        )

    async def do(
        self,
        op: int,
        what: str,
        data: bytes,
        offset: int = 0,
        session: int = 0,
        *,
        wait: float = 0.0,
    ) -> Reply:
        """Send a request that must succeed.

        :raises InvalidValue: no such file.
        :raises DeviceRejected: the vehicle refuses it.
        """
        reply = await self.request(op, session, offset, data, wait=wait)
        if reply.error == _NO_SESSION:  # stale, or left open by another client
            await self.request(Op.RESET)
            reply = await self.request(op, session, offset, data)
        if reply.error:
            raise _refusal(reply, what)
        return reply

    @asynccontextmanager
    async def opened(self, op: int, path: bytes, what: str) -> AsyncGenerator[tuple[int, int]]:
        """Open a file while entered; yields the session and the file's size."""
        reply = await self.do(op, what, path)
        size = int.from_bytes(reply.data[:4], "little") if op == Op.OPEN_TO_READ else 0
        try:
            yield reply.session, size
        except BaseException:  # a cancelled caller does not wait for the close
            self._send(self._next(), Op.TERMINATE, reply.session, 0, b"", 0)
            raise
        ended = await self.request(Op.TERMINATE, reply.session)
        if ended.error:
            raise _refusal(ended, what)

    # Reading

    async def read(
        self, session: int, gaps: Gaps, what: str, on_progress: Callable[[float], None]
    ) -> None:
        """Fill the gaps: large ones by bursts, small ones by single requests."""
        gently = False
        while (gap := gaps.first()) is not None:
            start, stop = gap
            if stop - start >= _BURST_FROM and not gently:
                gently = not await self._one_burst(session, start, gaps, on_progress)
                continue
            reply = await self.request(Op.READ, session, start, size=min(PIECE, stop - start))
            if reply.error == _END_OF_FILE or (not reply.error and not reply.data):
                gaps.end(start)
                continue
            if reply.error:
                raise _refusal(reply, what)
            gaps.add(start, reply.data)
            gently = False
            on_progress(gaps.part)

    async def _one_burst(
        self, session: int, start: int, gaps: Gaps, on_progress: Callable[[float], None]
    ) -> bool:
        """Request a burst from an offset; return whether more is needed."""
        seq = self._next()
        arrived, over = asyncio.Event(), False
        fresh = 0

        def take(reply: Reply) -> None:
            nonlocal over, fresh
            if reply.session != session or (reply.seq - seq - 1) & 0xFFFF >= 0x8000:
                return
            self._seq = reply.seq
            if reply.error:
                over = True
            else:
                fresh += gaps.add(reply.offset, reply.data)
                over = reply.complete
            arrived.set()

        self._burst = take
        try:
            self._vehicle.check()
            self._send(seq, Op.BURST, session, start, b"", PIECE)
            while not over and gaps.first() is not None:
                arrived.clear()
                try:
                    async with timeout(self._hub.config.timeout):
                        await arrived.wait()
                except TimeoutError:
                    self._seq = (self._seq + _LATE) & 0xFFFF
                    self._vehicle.check()
                    break
                on_progress(gaps.part)
        finally:
            self._burst = None
        return fresh > 0

    # Writing

    async def write(
        self,
        session: int,
        offset: int,
        data: bytes,
        what: str,
        on_progress: Callable[[float], None],
    ) -> None:
        """Write at an offset, with several chunks in flight."""
        written = 0

        async def work(pieces: Iterator[int]) -> None:
            nonlocal written
            for at in pieces:
                piece = data[at : at + PIECE]
                await self.do(Op.WRITE, what, piece, offset + at, session)
                written += len(piece)
                on_progress(written / len(data))

        pieces = iter(range(0, len(data), PIECE))
        try:
            async with TaskGroup() as group:
                for _ in range(_AT_ONCE):
                    group.create_task(work(pieces))
        except ExceptionGroup as failed:  # before Python 3.11.4, `except*` wraps what it raises
            raise failed.exceptions[0] from None


def _refusal(reply: Reply, what: str) -> RcpError:
    code = reply.error
    words = _WORDS.get(code, f"error {code}")
    if code == _ERRNO and len(reply.data) > 1:
        words = os.strerror(reply.data[1])
    details = {"result": words}
    if code == _NOT_FOUND:
        return InvalidValue(
            f"{what}: {words}",
            remedy="List existing files with service/ftp/list.",
            details={**details, "pointer": "/path"},
        )
    if code == _UNKNOWN:
        return NotImplementedByRobot(f"{what}: the vehicle cannot do that over FTP")
    return DeviceRejected(f"{what}: {words}", details=details)
