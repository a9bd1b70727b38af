"""One open WebSocket: picows does the framing, this class the rest of RFC 6455.

It handles fragmentation, the closing handshake, UTF-8, compression and keepalive. Its user receives
whole messages, writes batches, and sees in a flag when to wait. It is
`scope["extensions"]["rcp.socket"]` of the ASGI applications below the listener.
"""

from __future__ import annotations

import asyncio
import zlib

import structlog
from picows import WSFrame, WSListener, WSMsgType, WSTransport

from rcp_asgi import heads
from rcp_asgi.deflate import TooLong, deflate, inflate
from rcp_asgi.receiver import Receiver
from rcp_asgi.settings import Settings

__all__ = ["Socket"]

_TEXT, _BINARY, _CONTINUATION = WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.CONTINUATION
_PING, _PONG, _CLOSE = WSMsgType.PING, WSMsgType.PONG, WSMsgType.CLOSE
_OBJECT = 0x7B  # "{": only JSON starts with it; CBOR and MessagePack maps do not
_HIGH_WATER = 64 * 1024  # bytes in the write buffer above which the socket is not writable
_CLOSE_WAIT = 2.0  # s for the peer to answer a close
_UNANSWERED = 2  # unanswered pings after which the peer counts as gone
# RFC 6455 7.4.1
log = structlog.get_logger("rcp.asgi")
_PROTOCOL_ERROR = 1002
_GONE = 1006
_INVALID_TEXT = 1007
_INTERNAL = 1011


class Socket(WSListener):
    """The native handle of a WebSocket. Use it on the event loop's thread only."""

    __slots__ = (
        "_compressed",
        "_gathers",
        "_heard",
        "_loop",
        "_opcode",
        "_owner",
        "_parts",
        "_pong",
        "_raw",
        "_reading",
        "_receive",
        "_receiver",
        "_settings",
        "_settled",
        "_size",
        "_threshold",
        "_timer",
        "_transport",
        "_unanswered",
        "code",
        "compresses",
        "deflates",
        "limit",
        "open",
        "writable",
    )

    def __init__(
        self, settings: Settings, receiver: Receiver, loop: asyncio.AbstractEventLoop
    ) -> None:
        self.writable = False
        """Whether the write buffer has room; the receiver is notified by `drained`."""
        self.deflates = False
        """Whether permessage-deflate was negotiated."""
        self.compresses = False
        """Whether compressing messages to this client is worthwhile."""
        self.code = _GONE
        self.open = False
        self._settings = settings
        self._owner = self._receiver = receiver
        self._receive = receiver.received
        self._settled = receiver.settled
        self._loop = loop
        self._transport: WSTransport
        self._raw: asyncio.Transport
        self._gathers = False
        """Whether its `writelines` is one system call."""
        self.limit = settings.client_api.limits.message
        """Maximum length of a received message, reassembled and decompressed."""
        self._threshold = settings.config.compress_above
        self._parts: list[bytes] | None = None
        """The fragments of an incomplete message; empty once it is too long."""
        self._size = 0
        self._opcode = _TEXT
        self._compressed = False
        self._heard = True
        self._unanswered = 0
        self._timer: asyncio.TimerHandle | None = None
        self._pong: bytes | None = None
        self._reading = True

    def attach(self, receiver: Receiver) -> None:
        """Replace the receiver."""
        self._receiver = receiver
        self._receive = receiver.received
        self._settled = receiver.settled

    # -- picows --------------------------------------------------------------------------------

    def on_ws_connected(self, transport: WSTransport) -> None:
        """Start."""
        self._transport = transport
        self._raw = transport.underlying_transport
        self._raw.set_write_buffer_limits(high=_HIGH_WATER)
        # `writelines` of asyncio copies all, or never tells that the buffer is full: gh-127655.
        self._gathers = type(self._raw).__module__.startswith("uvloop")
        self.open = self.writable = True
        self._rest()

    def on_ws_frame(self, transport: WSTransport, frame: WSFrame) -> None:
        """Dispatch a frame; the first branch handles nearly all."""
        self._heard = True
        opcode = frame.msg_type
        try:
            if (
                (opcode is _TEXT or opcode is _BINARY)
                and frame.fin
                and self._parts is None
                and not (frame.rsv1 or frame.rsv2 or frame.rsv3)
            ):
                if self.open:
                    data = frame.get_payload_as_bytes()
                    if opcode is _BINARY or data.isascii() or _is_utf8(data):
                        self._receive(data, opcode is _TEXT)
                    else:
                        self._garbled(data)
            else:
                self._other(frame, opcode)
            if frame.last_in_buffer:
                if self._pong is not None and self.writable and self.open:
                    self._send_pong()
                self._settled()
        except Exception:
            log.exception("websocket_failed", opcode=str(opcode))
            self._fail(_INTERNAL, "the gateway failed; see its log")

    def on_ws_disconnected(self, transport: WSTransport) -> None:
        """Stop."""
        self.end()

    def end(self) -> None:
        """Notify the receiver that there is no connection, or never was one."""
        self.open = False
        self.writable = False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._parts = None
        self._owner.lost(self.code)
        if self._receiver is not self._owner:
            self._receiver.lost(self.code)

    def pause_writing(self) -> None:
        """Handle a peer that does not read."""
        self.writable = False

    def resume_writing(self) -> None:
        """Continue: the peer has read data, so it is alive."""
        self._heard = True
        if not self.open:
            return
        self.writable = True
        if self._pong is not None:
            self._send_pong()
        self._receiver.drained()

    # -- frames that are not whole messages ----------------------------------------------------

    def _other(self, frame: WSFrame, opcode: WSMsgType) -> None:
        if opcode is _PING or opcode is _PONG or opcode is _CLOSE:
            self._control(frame, opcode)
        elif self.open:
            self._fragment(frame, opcode)
        if self.open:
            self._receiver.other_frame()

    def _send_pong(self) -> None:
        payload, self._pong = self._pong, None
        self._transport.send_pong(payload)

    def _control(self, frame: WSFrame, opcode: WSMsgType) -> None:
        if frame.rsv1 or frame.rsv2 or frame.rsv3:
            self._fail(_PROTOCOL_ERROR, "reserved bits")
        elif opcode is _PING:
            self._pong = frame.get_payload_as_bytes()  # RFC 6455 5.5.3: the latest suffices
        elif opcode is _CLOSE:
            self._closed_by_peer(frame)

    def _closed_by_peer(self, frame: WSFrame) -> None:
        payload = frame.get_payload_as_bytes()
        code = int.from_bytes(payload[:2], "big") if payload else 1005
        if payload and (code in (0, 1004, 1005, 1006) or code > 4999):
            code, payload = 1002, b"\x03\xea"
        if self.open:
            self.open = False
            self.code = code
            self._transport.send(_CLOSE, payload[:2])
        self._transport.disconnect()

    def _fragment(self, frame: WSFrame, opcode: WSMsgType) -> None:
        parts = self._parts
        begins = opcode is not _CONTINUATION
        bad_bits = frame.rsv2 or frame.rsv3 or (frame.rsv1 and not (self.deflates and begins))
        if bad_bits or begins is (parts is not None):
            self._fail(_PROTOCOL_ERROR, "frames out of order or reserved bits")
            return
        if parts is None:
            parts = self._parts = []
            self._size = 0
            self._opcode = opcode
            self._compressed = bool(frame.rsv1)
        data = frame.get_payload_as_bytes()
        self._size += len(data)
        if self._size > self.limit:
            parts.clear()
        elif data:  # otherwise there could be any number of empty ones
            parts.append(data)
        if frame.fin:
            self._parts = None
            self._complete(b"".join(parts))

    def _complete(self, data: bytes) -> None:
        if self._size > self.limit:
            self._receiver.oversized(self._size)
            return
        if self._compressed:
            try:
                data = inflate(data, self.limit)
            except TooLong:
                self._receiver.oversized(self.limit + 1)
                return
            except zlib.error:
                self._fail(_INVALID_TEXT, "the compressed message is damaged")
                return
        text = self._opcode is _TEXT
        if text and not _is_utf8(data):
            self._garbled(data)
        else:
            self._receive(data, text)

    def _garbled(self, data: bytes) -> None:
        # RFC 6455 8.1: the connection fails; the request still gets its reply.
        self._receiver.garbled(data)
        self._fail(_INVALID_TEXT, "the text is not UTF-8")

    # -- sending -------------------------------------------------------------------------------

    def write(self, messages: list[bytes]) -> None:
        """Send whole messages in one write; JSON objects as text, others as binary."""
        if self._gone():
            return
        if self.compresses:
            for data in messages:
                self.send(data, text=data[:1] == b"{")
            return
        if len(messages) == 1:
            data = messages[0]
            self._transport.send(_TEXT if data[0] == _OBJECT else _BINARY, data)
            return
        short: list[bytes] = []
        for data in messages:
            if len(data) <= heads.JOINED:
                short.append(data)
                continue
            if short:
                self._raw.write(heads.join(short))
                short = []
            self._transport.send(_TEXT if data[0] == _OBJECT else _BINARY, data)
        if short:
            self._raw.write(heads.join(short))

    @property
    def buffered(self) -> int:
        """Number of bytes that the peer has not read yet."""
        return 0 if self._gone() else self._raw.get_write_buffer_size()

    def reply(self, data: bytes) -> None:
        """Send one message, uncompressed; picows frames it without an additional copy."""
        if self.open and not self._raw.is_closing():
            self._transport.send(_TEXT if data[0] == _OBJECT else _BINARY, data)

    def _gone(self) -> bool:
        """Return whether nothing can be written any more, even before the loop reports the loss."""
        return not self.open or self._raw.is_closing()

    @staticmethod
    def head(size: int, text: bool) -> bytes:  # noqa: FBT001 - a frame's own flag
        """Return the head of a frame around a whole message of `size` bytes."""
        return (heads.TEXT if text else heads.BINARY)[size]

    def pass_on(self, parts: list[bytes]) -> int | None:
        """Send framed data if there is room for it; return the bytes unread since, None if there was none."""
        raw = self._raw
        if not (self.writable and self.open) or raw.is_closing():
            return None
        if len(parts) == 1:
            raw.write(parts[0])
        else:
            self.write_frames(parts)
        return 0 if self.writable else raw.get_write_buffer_size()

    def write_frames(self, parts: list[bytes]) -> None:
        """Send framed data, in one write where the loop can; only short parts are copied."""
        if not self.open or self._raw.is_closing():
            return
        if len(parts) == 1:
            self._raw.write(parts[0])
        elif max(map(len, parts)) <= heads.JOINED:
            self._raw.write(b"".join(parts))
        elif self._gathers:
            self._raw.writelines(heads.merged(parts))
        else:
            for data in heads.merged(parts):
                if self._raw.is_closing():  # the write before has found it broken
                    return
                self._raw.write(data)

    def send(self, data: bytes, *, text: bool) -> None:
        """Send one message."""
        if not self.open:
            return
        opcode = _TEXT if text else _BINARY
        if self.compresses and len(data) > self._threshold:
            self._transport.send(opcode, deflate(data), True, True)
        else:
            self._transport.send(opcode, data)

    @property
    def reading(self) -> bool:
        """Whether the transport should read: not while paused, but always during a close."""
        return self._reading or not self.open

    def pause_reading(self) -> None:
        """Stop reading until `resume_reading`; frames already read are still delivered."""
        if self.open and self._reading:
            self._reading = False
            self._raw.pause_reading()

    def resume_reading(self) -> None:
        """Resume reading."""
        if self.open and not self._reading:
            self._reading = True
            self._raw.resume_reading()

    def close(self, code: int, reason: str = "") -> None:
        """Start the closing handshake; the peer has a limited time to answer."""
        if not self.open:
            return
        self.open = False
        self.code = code
        payload = self.code.to_bytes(2, "big") + reason.encode()[:120]
        self._transport.send(_CLOSE, payload)
        if not self._reading:
            self._raw.resume_reading()
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(_CLOSE_WAIT, self.abort)

    def _fail(self, code: int, reason: str) -> None:
        """Close because of a protocol error; further input is ignored (RFC 6455 7.1.7).

        Only the sending side is shut down at once: a reset would discard the close frame.
        """
        self.close(code, reason)
        if self._raw.can_write_eof():  # not with TLS: the peer or the timer ends it
            self._raw.write_eof()

    def abort(self) -> None:
        """Close the connection at once."""
        self._raw.abort()

    # -- keepalive -----------------------------------------------------------------------------

    def _rest(self) -> None:
        self._timer = self._loop.call_later(self._settings.client_api.limits.heartbeat, self._beat)

    def _beat(self) -> None:
        if self._heard:
            self._unanswered = 0
        elif self._unanswered >= _UNANSWERED:
            if self.open and self.writable and not self._reading:
                log.error(
                    "websocket_not_read",
                    seconds=_UNANSWERED * self._settings.client_api.limits.heartbeat,
                )
            self.code = _GONE
            self.abort()
            return
        self._heard = False
        self._unanswered += 1
        if self.writable:
            self._transport.send_ping(b"")
        self._rest()


def _is_utf8(data: bytes) -> bool:
    if data.isascii():
        return True
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True
