"""The diagnostic stream of a moteus: lines of text in CAN FD frames, as moteus_tool and tview send them.

A drive sends only what it is polled for. What is lost on the way is lost: no answer is asked for again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from rcp_can.asking import answer_to
from rcp_can.bus import Bus, Route
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["CHANNEL", "FROM_DRIVE", "POLL", "TO_DRIVE", "Stream", "content"]

TO_DRIVE, FROM_DRIVE, POLL = 0x40, 0x41, 0x42
CHANNEL = 1
_PART = 61  # bytes of text in a frame
_POLLED = 0.5  # s
_PAUSE = 0.01  # s before a drive that had nothing to say is polled again
_LONGEST = 200_000  # bytes of an answer
_NOISE = 1000  # polls in which an earlier answer must have ended


class Stream:
    """The text console of one drive; one command at a time.

    `send` takes a node, the payloads of frames and whether an answer is due; it sends all or none, as
    the next command would continue a part.
    """

    def __init__(
        self, bus: Bus, source: int, send: Callable[[int, Sequence[bytes], bool], None]
    ) -> None:
        self._bus, self._source, self._send = bus, source, send
        self._lock = asyncio.Lock()

    async def command(
        self, text: str, *, node: int, answers_as: int | None = None, seconds: float = _POLLED
    ) -> list[str]:
        """Send a command that ends with `OK`; return the lines before it.

        `answers_as` is the id to which the drive listens after the command.

        :raises DeviceRejected: the drive refuses it, with its reason, or its answer does not end.
        :raises DeviceTimeout: it does not answer within `seconds`.
        """
        async with self._lock:
            return await self._run(text, node, answers_as or node, seconds, until="OK")

    async def ask(self, text: str, *, node: int) -> str:
        """Send a command that is answered by one line; return that."""
        async with self._lock:
            return (await self._run(text, node, node, _POLLED, until=None))[0]

    async def _run(
        self, text: str, node: int, then: int, seconds: float, *, until: str | None
    ) -> list[str]:
        await self._drain(node)
        data = text.encode("ascii") + b"\n"
        parts = [data[start : start + _PART] for start in range(0, len(data), _PART)]
        self._send(node, [bytes((TO_DRIVE, CHANNEL, len(part))) + part for part in parts], False)
        return await self._lines(then, seconds, until)

    async def _lines(self, node: int, seconds: float, until: str | None) -> list[str]:
        loop = asyncio.get_running_loop()
        end, left, heard = loop.time() + seconds, _LONGEST, b""
        lines: list[str] = []
        while True:
            part = await self._poll(node, max(seconds, _POLLED))
            heard += part
            *whole, heard = heard.replace(b"\r", b"\n").split(b"\n")
            for raw in filter(None, whole):
                line = raw.decode("latin-1").strip()
                if line.startswith("ERR"):
                    raise DeviceRejected(f"the drive refused: {line}")
                if line == until:
                    return lines
                lines.append(line)
                if until is None:
                    return lines
            if part:
                end = loop.time() + seconds
                left -= len(part)
                if left < 0:
                    raise _endless(node)
            elif loop.time() > end:
                raise DeviceTimeout(f"node {node}: the answer did not end within {seconds:g} s")
            else:
                await asyncio.sleep(_PAUSE)

    async def _drain(self, node: int) -> None:
        """Take what is left of an earlier answer.

        :raises DeviceRejected: it does not end.
        """
        for _ in range(_NOISE):
            if not await self._poll(node, _POLLED):
                return
        raise _endless(node)

    async def _poll(self, node: int, seconds: float) -> bytes:
        """Return the next text, if there is any.

        :raises DeviceTimeout: the drive does not answer, or its answer was lost.
        """
        value = node << 8 | self._source
        answer = await answer_to(
            self._bus,
            [Route(value, 0x7FFF, extended=extended) for extended in (True, False)],
            lambda: self._send(node, [bytes((POLL, CHANNEL, _PART))], True),
            lambda message: content(message) is not None,
            seconds=seconds,
            once=True,
        )
        if answer is None:
            raise DeviceTimeout(
                f"node {node}: a part of its answer did not arrive",
                remedy="Check the bus (sensor/can/…/state), then send it again.",
            )
        return content(answer) or b""


def _endless(node: int) -> DeviceRejected:
    return DeviceRejected(
        f"node {node} does not stop telling something",
        remedy="Close tview or moteus_tool, or send `tel stop` with it.",
    )


def content(message: can.Message) -> bytes | None:
    """Return the text in a frame of a drive; None if it is another frame."""
    data = bytes(message.data)
    if len(data) < 3 or data[:2] != bytes((FROM_DRIVE, CHANNEL)) or len(data) < 3 + data[2]:
        return None
    return data[3 : 3 + data[2]]
