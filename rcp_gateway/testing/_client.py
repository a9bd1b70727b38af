"""A client that speaks envelopes, whatever carries them; and the one that needs no carrier."""

from __future__ import annotations

import asyncio
import itertools
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import cbor2
import msgspec

from rcp_gateway.client_api import ClientApi
from rcp_kernel.values import Encoding
from rcp_protocol.timeouts import timeout

__all__ = ["BOUND", "Client", "MemoryClient", "Message", "decode", "encode"]

BOUND = 60.0  # s that any wait of a test may take, also on a busy machine
_FINAL = frozenset(("completed", "failed", "rejected", "cancelled"))

Message = dict[str, Any]
"""One envelope as plain data."""


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"a bare {name} in JSON")


def encode(message: Any, encoding: Encoding) -> bytes:
    """Write plain data in an encoding, by libraries that the gateway's own codec does not use."""
    if encoding is Encoding.JSON:
        return json.dumps(message).encode()
    if encoding is Encoding.CBOR:
        return cbor2.dumps(message)
    return msgspec.msgpack.encode(message)


def decode(data: bytes, encoding: Encoding) -> Any:
    """Decode plain data, as strictly as the encoding's standard requires."""
    if encoding is Encoding.JSON:
        return json.loads(data, parse_constant=_no_constant)
    if encoding is Encoding.CBOR:
        return cbor2.loads(data)
    return msgspec.msgpack.decode(data)


class Client(ABC):
    """Sends requests and sorts the replies; every wait is bounded and reports what was missing."""

    def __init__(self, encoding: Encoding = Encoding.JSON) -> None:
        self.encoding = encoding
        self.inbox: list[Message] = []
        """Received messages that no test has taken yet, in order."""
        self.reading = asyncio.Event()
        """Cleared by `pause`: nothing is taken from the carrier."""
        self.reading.set()
        self._waiting: dict[asyncio.Future[Message], Callable[[Message], bool]] = {}
        self._count = itertools.count(1)

    @abstractmethod
    async def transmit_raw(self, data: bytes) -> None:
        """Send one message as it is, well-formed or not."""

    @abstractmethod
    async def close(self) -> None:
        """Cut the connection."""

    def pause(self) -> None:
        """Stop reading from the gateway: a client that does not keep up."""
        self.reading.clear()

    def resume(self) -> None:
        """Read again, including queued messages."""
        self.reading.set()

    async def transmit(self, message: Message) -> None:
        """Send one envelope."""
        await self.transmit_raw(encode(message, self.encoding))

    def received(self, message: Message) -> None:
        """Store a received message, for a current or later wait."""
        for future, wanted in self._waiting.items():
            if not future.done() and wanted(message):
                future.set_result(message)
                return
        self.inbox.append(message)

    async def send(self, envelope: Mapping[str, Any] | None = None, /, **fields: Any) -> str:
        """Send a request, with a new id unless one is given; return the id."""
        message: Message = {**(envelope or {}), **fields}
        id_: str = message.setdefault("id", f"c-{next(self._count)}")
        await self.transmit(message)
        return id_

    async def request(
        self, type_: str, path: str | None = None, *, within: float = BOUND, **fields: Any
    ) -> Message:
        """Send a request and return its final reply."""
        if path is not None:
            fields["path"] = path
        return await self.final(await self.send(fields, type=type_), within)

    async def until(self, wanted: Callable[[Message], bool], within: float = BOUND) -> Message:
        """Take the first message for which `wanted` holds out of the inbox.

        :raises AssertionError: none arrived within `within` seconds.
        """
        for place, message in enumerate(self.inbox):
            if wanted(message):
                return self.inbox.pop(place)
        future = asyncio.get_running_loop().create_future()
        self._waiting[future] = wanted
        try:
            async with timeout(within):
                return await future
        except TimeoutError:
            held = f"{self.inbox!r:.2000}"
            raise AssertionError(f"nothing of the kind in {within} s; it holds {held}") from None
        finally:
            del self._waiting[future]

    async def reply(self, id_: str | None, within: float = BOUND) -> Message:
        """Wait for the next reply to a request, final or not."""
        return await self.until(lambda m: _answers(m, id_), within)

    async def final(self, id_: str | None, within: float = BOUND) -> Message:
        """Wait for the final reply to a request."""
        return await self.until(lambda m: _answers(m, id_) and m["status"] in _FINAL, within)

    async def replies(self, id_: str, within: float = BOUND) -> list[Message]:
        """Wait for every reply to a request, the final one last."""
        found = [await self.reply(id_, within)]
        while found[-1]["status"] not in _FINAL:
            found.append(await self.reply(id_, within))
        return found

    async def update(self, id_: str, within: float = BOUND) -> Message:
        """Wait for the next update of a subscription."""
        return await self.until(lambda m: m["type"] == "update" and m["id"] == id_, within)

    async def notice(self, code: str, within: float = BOUND) -> Message:
        """Wait for a notice."""
        return await self.until(lambda m: m["type"] == "notice" and m["code"] == code, within)

    async def subscribe(self, path: str, **options: Any) -> str:
        """Subscribe with the options of the body; return the subscription's id."""
        reply = await self.request("subscribe", path, body=options)
        assert reply["status"] == "completed", reply
        return reply["body"]["subscription"]


def _answers(message: Message, id_: str | None) -> bool:
    return message["type"] not in ("update", "notice") and message.get("id") == id_


class MemoryClient(Client):
    """A client without a socket: the gateway's own connection, message by message."""

    def __init__(
        self, client_api: ClientApi, token: str | None, encoding: Encoding = Encoding.JSON
    ) -> None:
        super().__init__(encoding)
        self.connection = client_api.connect(client_api.authenticate(token), encoding, self._flush)

    def _flush(self) -> None:
        while self.reading.is_set() and (batch := self.connection.outbox.collect()):
            for data in batch:
                self.received(decode(data, self.encoding))

    def resume(self) -> None:
        """Read again, including queued messages."""
        super().resume()
        self._flush()

    async def transmit_raw(self, data: bytes) -> None:
        """Hand one message over."""
        self.connection.receive(data)

    async def close(self) -> None:
        """Be gone."""
        self.connection.close()
