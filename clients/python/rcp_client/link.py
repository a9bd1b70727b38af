"""One WebSocket connection: opens it, splits and joins long messages, reports its end once."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
from ssl import SSLContext
from typing import Any

from msgspec import DecodeError, json
from picows import (
    WSCloseCode,
    WSError,
    WSFrame,
    WSHandshakeError,
    WSListener,
    WSMsgType,
    WSTransport,
    ws_connect,
)

from rcp_client.address import Address
from rcp_client.carrier import Lost, Received
from rcp_client.errors import ConnectionLost, error_of
from rcp_client.messages import Codec, Message, Reply
from rcp_client.segments import Assembler, split
from rcp_client.tls import tls_reason
from rcp_protocol.errors import Forbidden, RcpError, Unauthenticated
from rcp_protocol.timeouts import timeout

__all__ = ["Link"]

log = logging.getLogger("rcp.client")
_MAX_FRAME = 64 * 1024 * 1024  # bytes
_LIMIT = 256 * 1024 * 1024  # bytes of one segmented message
_SWEEP = 1.0  # s between two checks for missing segments
_PART_WAIT = 3.0  # s without a segment after which missing ones are requested again


class Link(WSListener):
    """The client's end of one connection; only for the event loop's thread."""

    def __init__(self, codec: Codec, received: Received, lost: Lost) -> None:
        self._codec = codec
        self._received = received
        self._lost = lost
        self._transport: WSTransport | None = None
        self._rest: list[bytes] = []
        self._assembler = Assembler(_LIMIT, patience=_PART_WAIT)
        self._sweep: asyncio.TimerHandle | None = None
        self._room = asyncio.Event()
        self._room.set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._names = itertools.count(1)
        self._kept: dict[str, list[bytes]] = {}
        """Segments of long messages already sent, in case the gateway requests them again."""
        self.segment_size: int | None = None
        """Longest frame the gateway accepts, once agreed."""
        self.closed = False
        self.why = "the connection was closed"

    @classmethod
    async def open(
        cls,
        address: Address,
        codec: Codec,
        token: str | None,
        received: Received,
        lost: Lost,
        *,
        patience: float,
        heartbeat: float,
        ssl: SSLContext | None,
    ) -> Link:
        """Connect.

        :raises ConnectionLost: there is no response, or not from a gateway.
        :raises Unauthenticated, Forbidden: the gateway refuses this token.
        """
        headers = {"Sec-WebSocket-Protocol": codec.subprotocol, "User-Agent": "rcp-client"}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        try:
            async with timeout(patience):
                transport, link = await ws_connect(
                    lambda: cls(codec, received, lost),
                    address.ws,
                    ssl_context=ssl,
                    max_redirects=0,  # the token is for this gateway only
                    websocket_handshake_timeout=patience,
                    enable_auto_ping=True,
                    auto_ping_idle_timeout=heartbeat,
                    auto_ping_reply_timeout=heartbeat,
                    max_frame_size=_MAX_FRAME,
                    extra_headers=headers,
                )
        except WSHandshakeError as error:
            raise _refusal(error, address) from error
        except (OSError, WSError) as error:
            number = getattr(error, "errno", None)
            reason = tls_reason(error) if isinstance(error, OSError) else None
            reason = reason or (os.strerror(number) if number else str(error) or "no answer")
            raise ConnectionLost(f"cannot reach {address.url}: {reason}") from error
        if not isinstance(link, cls):  # picows does so if the peer hangs up during the handshake
            raise ConnectionLost(f"{address.url} closed the connection")
        spoken = transport.response.headers.get("Sec-WebSocket-Protocol")
        if spoken != codec.subprotocol:
            transport.disconnect()
            raise ConnectionLost(f"{address.url} does not support {codec.subprotocol}")
        return link

    # -- sending -------------------------------------------------------------------------------

    def send(self, envelope: dict[str, Any]) -> None:
        """Send an envelope, in segments if it is long; does nothing on a closed link.

        :raises RcpError: the envelope cannot be encoded.
        """
        data = self._codec.encode(envelope)
        if self.segment_size is None or len(data) <= self.segment_size:
            self._write(data)
            return
        # Named after the request, so that a refused transfer is matched to it.
        name = str(envelope.get("id") or f"t{next(self._names)}")
        parts = split(data, name, self.segment_size, text=self._codec.is_text)
        frames = self._kept[name] = [self._codec.encode(part) for part in parts]
        while len(self._kept) > 4:
            del self._kept[next(iter(self._kept))]
        self._spawn(frames)

    def _spawn(self, frames: list[bytes]) -> None:
        task = asyncio.get_running_loop().create_task(self._write_all(frames))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _write_all(self, frames: list[bytes]) -> None:
        """Send segments only when the socket is ready, so that short messages fit in."""
        for frame in frames:
            await self._room.wait()
            self._write(frame)
            await asyncio.sleep(0)

    def _write(self, data: bytes) -> None:
        if self._transport is not None and not self.closed:
            kind = WSMsgType.TEXT if self._codec.is_text else WSMsgType.BINARY
            self._transport.send(kind, data)

    def close(self) -> None:
        """Close the connection; `lost` is called as for any other end."""
        if self._transport is not None and not self.closed:
            self._transport.send_close(WSCloseCode.OK)
            self._transport.disconnect()

    # -- receiving -----------------------------------------------------------------------------

    def on_ws_connected(self, transport: WSTransport) -> None:
        """Store the transport."""
        self._transport = transport

    def on_ws_frame(self, transport: WSTransport, frame: WSFrame) -> None:
        """Handle one frame; picows answers pings by itself."""
        kind = frame.msg_type
        if kind is WSMsgType.CLOSE:
            reason = frame.get_close_reason()
            self.why = f"the gateway closed the connection{': ' + reason if reason else ''}"
            transport.send_close(frame.get_close_code())
            transport.disconnect()
            return
        if kind not in (WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.CONTINUATION):
            return
        data = frame.get_payload_as_bytes()
        if not frame.fin:
            self._rest.append(data)
            return
        if self._rest:
            data = b"".join((*self._rest, data))
            self._rest.clear()
        self._take(data)

    def _take(self, data: bytes) -> None:
        try:
            message = self._codec.decode(data)
        except ValueError as error:
            log.warning("the gateway sent a malformed envelope: %s", error)
            return
        if message.type != "segment" or message.status:  # the reply to a transfer
            self._received(message, data)
        elif message.body is None:
            self._send_again(message, data)
        else:
            self._join(message)

    def _join(self, segment: Message) -> None:
        try:
            whole = self._assembler.add(segment)
        except RcpError as error:
            log.warning("%s", error.message)
            missing = (error.details or {}).get("missing")
            if missing and segment.id:
                self._ask_again(segment.id, missing)
            return
        if whole is not None:
            self._take(whole)
        elif self._sweep is None:
            self._sweep = asyncio.get_running_loop().call_later(_SWEEP, self._look)

    def _look(self) -> None:
        self._sweep = None
        try:
            for name, missing in self._assembler.overdue().items():
                self._ask_again(name, missing)
        except RcpError as error:
            log.warning("%s", error.message)
        if len(self._assembler) and not self.closed:
            self._sweep = asyncio.get_running_loop().call_later(_SWEEP, self._look)

    def _ask_again(self, name: str, missing: list[int]) -> None:
        self._write(self._codec.encode({"type": "segment", "id": name, "resend": missing[:1000]}))

    def _send_again(self, request: Message, data: bytes) -> None:
        frames = self._kept.get(request.id or "")
        if frames is None:
            return
        missing = self._codec.notice(data).facts.get("resend") or range(len(frames))
        self._spawn([frames[num] for num in missing if 0 <= num < len(frames)])

    def pause_writing(self) -> None:
        """Pause long messages: the socket buffer is full."""
        self._room.clear()

    def resume_writing(self) -> None:
        """Resume long messages."""
        self._room.set()

    def on_ws_disconnected(self, transport: WSTransport) -> None:
        """Report the end, once."""
        self.closed = True
        if self._sweep is not None:
            self._sweep.cancel()
        for task in self._tasks:
            task.cancel()
        self._lost(self)


def _refusal(error: WSHandshakeError, address: Address) -> RcpError:
    """Return the error for an HTTP response instead of the upgrade."""
    response = error.response
    if response is None:
        return ConnectionLost(f"{address.url} does not respond like a gateway: {error}")
    try:
        refusal = error_of(json.decode(error.raw_body or response.body or b"", type=Reply))
    except (DecodeError, UnicodeDecodeError):
        refusal = None
    if refusal is not None:
        return refusal
    status = int(response.status)
    if status in (401, 403):
        kind = Unauthenticated if status == 401 else Forbidden
        return kind(f"{address.url} refused this client (HTTP {status})")
    return ConnectionLost(
        f"{address.url} is not an RCP gateway: HTTP {status} instead of a WebSocket"
    )
