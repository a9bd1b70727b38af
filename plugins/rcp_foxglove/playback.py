"""The replay of a recording, as a viewer shows and controls it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from typing import Any, Literal, NamedTuple

import msgspec

from rcp_foxglove.frames import Control, playback_state, time_frame
from rcp_foxglove.requests import Requests
from rcp_foxglove.statuses import WARNING, Statuses, refusal_text
from rcp_foxglove.views import Replay, View
from rcp_gateway.api import Connection, Rendering, Sample
from rcp_kernel.clock import iso, parse_time
from rcp_kernel.errors import Overrun, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request, encode_body

__all__ = ["Playback"]

_PERIOD = 0.05  # s between two messages with the recording's time
_NS = 1_000_000_000
_END = 2**64  # ns
_FASTEST = 1e6
_STATUS = {"playing": 0, "paused": 1, "ended": 3}


class _Report(msgspec.Struct, frozen=True):
    """What is used of the value of a replay's state."""

    state: Literal["playing", "paused", "ended"]
    position: str
    start: str
    end: str
    speed: float
    jumps: int = 0


class _State(NamedTuple):
    """Where a replay was, times in ns."""

    state: Literal["playing", "paused", "ended"]
    position: int
    range: tuple[int, int]
    speed: float
    jumps: int


class Playback:
    """The one replay that a client sees.

    Its time goes on as that of the backend, from each report of where it is to the next.
    """

    def __init__(
        self,
        requests: Requests,
        connection: Connection,
        statuses: Statuses,
        send_time: Callable[[int], None],
        announce: Callable[[], None],
    ) -> None:
        """`announce` is called when the times of the recording are others."""
        self._requests = requests
        self._connection = connection
        self.states = True
        """Whether the client knows messages with the state of a replay: only those of the newer
        subprotocol do. Others see the time."""
        self._statuses = statuses
        self._send_time = send_time
        self._announce = announce
        self._loop = requests.client_api.loop
        self._next = count(1)
        self._replay: Replay | None = None
        self._state: _State | None = None
        self._reported = float("-inf")
        """The loop's time at the last report."""
        self._subscription: str | None = None
        self._told_jumps = 0
        self._last: tuple[str, float] | None = None
        """The state and the speed that the client was told."""
        self._timer: asyncio.TimerHandle | None = None
        self._wish: Control | None = None
        """What the client wants next: only the newest counts."""
        self._busy = False
        self._seeking: str | None = None
        """Id of the request whose answer is the report of its seek."""

    @property
    def active(self) -> bool:
        """Whether the client's time is that of a recording."""
        return self._state is not None

    @property
    def controlled(self) -> tuple[int, int] | None:
        """Begin and end of the recording in ns, if the client may control it."""
        return self._state.range if self._state is not None and self._control else None

    @property
    def _control(self) -> str | None:
        """The path of the service that controls the replay, if the client may use it and can."""
        return self._replay.control if self._replay is not None and self.states else None

    async def renew(self, view: View) -> None:
        """Apply another view of the tree; `follow` comes next."""
        if view.replay == self._replay:
            return
        had = self.active
        self._drop()
        replay = view.replay
        if replay is not None:
            reply = await self._requests.request(Request(type="read", path=replay.state))
            with suppress(RcpError):  # it is shown as any other resource
                state = _of_reply(reply)
                self._replay, self._state = replay, state
                self._told_jumps, self._reported = state.jumps, self._loop.time()
        if had or self.active:
            self._announce()

    def follow(self) -> None:
        """Tell where the replay is from now on."""
        if self._replay is None or self._subscription is not None:
            return
        id_ = self._subscription = f"playback{next(self._next)}"
        self._connection.outbox.render(id_, Rendering(b"", self._told))
        body = msgspec.Raw(b'{"encoding":"cbor","qos":{"depth":4}}')  # binary messages
        request = Request(type="subscribe", id=id_, path=self._replay.state, body=body)

        def answer(reply: Reply) -> None:
            if reply.error is not None:
                self._statuses.tell(f"The replay cannot be followed: {refusal_text(reply)}")

        self._requests.client_api.submit(self._connection.session, request, answer)

    def control(self, wish: Control) -> None:
        """Do what the client wants; it is told where the replay is then, or why not."""
        if self._control is None:
            self._statuses.tell(
                "There is no replay that this client may control, or more than one. Connect to the "
                "tenant of one, with a key that may execute its service.",
                WARNING,
            )
            return
        waits = self._wish
        keeps = waits is not None and wish.seek is None
        self._wish = wish._replace(seek=waits.seek) if keeps and waits is not None else wish
        if not self._busy:
            self._busy = True
            self._requests.begin(self._carry_out())

    async def _carry_out(self) -> None:
        try:
            while (wish := self._wish) is not None:
                self._wish = None
                if (path := self._control) is not None:  # else the replay has ended meanwhile
                    await self._change(wish, path)
        finally:
            self._busy = False

    async def _change(self, wish: Control, path: str) -> None:
        body: dict[str, object] = {"paused": wish.paused, "speed": wish.speed}
        if wish.seek is not None:
            body["seek"] = iso(wish.seek)
            self._seeking = wish.id
        request = Request(type="execute", path=path, body=msgspec.Raw(msgspec.json.encode(body)))
        reply = await self._requests.request(request)
        told = wish.seek is not None and self._seeking is None
        self._seeking = None
        if reply.error is not None or reply.status != "completed":
            self._statuses.tell(f"The replay was not changed: {refusal_text(reply)}")
        elif self._control == path:  # else the view has changed meanwhile
            with suppress(RcpError):  # the next report says where it is
                self._take(_of_reply(reply))
        if not told and self.active:
            self._connection.outbox.put(self._frame(wish.id))

    def _told(self, sample: Sample) -> bytes:
        """Return the message for a report, which is the answer to the seek that it is about."""
        state = _of_value(sample.value)
        self._take(state)
        id_ = ""
        if self._seeking is not None and state.jumps != self._told_jumps:
            id_, self._seeking = self._seeking, None
        return self._frame(id_)

    def _take(self, state: _State) -> None:
        others = self._state is not None and state.range != self._state.range
        self._state, self._reported = state, self._loop.time()
        if others:
            self._announce()
        if state.state == "playing" and self._timer is None:
            self._timer = self._loop.call_later(_PERIOD, self._tick)

    def _frame(self, id_: str) -> bytes:
        """Return the state where it is an answer or has changed, and otherwise the time."""
        state = self._state
        assert state is not None
        seeked, self._told_jumps = state.jumps != self._told_jumps, state.jumps
        last, self._last = self._last, (state.state, state.speed)
        if not self.states or not (id_ or seeked or last != self._last):
            return time_frame(self._position(state))
        status = _STATUS[state.state]
        return playback_state(status, self._position(state), state.speed, seeked=seeked, id_=id_)

    def _position(self, state: _State) -> int:
        moment = state.position
        if state.state == "playing":
            moment += int((self._loop.time() - self._reported) * state.speed * _NS)
        return min(moment, state.range[1])

    def _tick(self) -> None:
        state = self._state
        if state is None or state.state != "playing":
            self._timer = None
            return
        self._timer = self._loop.call_later(_PERIOD, self._tick)
        self._send_time(self._position(state))

    def _drop(self) -> None:
        id_, self._subscription = self._subscription, None
        self._replay = self._state = self._last = None
        if id_ is not None:
            self._connection.outbox.render(id_, None)
            body = msgspec.Raw(msgspec.json.encode({"subscription": id_}))
            request = Request(type="unsubscribe", body=body)
            self._requests.client_api.submit(self._connection.session, request, _ignore)

    def close(self) -> None:
        """Tell nothing more."""
        if self._timer is not None:
            self._timer.cancel()


def _of_reply(reply: Reply) -> _State:
    """Return the state that a reply has.

    :raises Overrun: it has none.
    """
    if reply.error is not None:
        raise Overrun("the replay has no state")
    return _of_value(msgspec.json.decode(encode_body(reply.body, Encoding.JSON)))


def _of_value(value: Any) -> _State:
    """Return a replay's state, which may come from another gateway.

    :raises Overrun: it is none.
    """
    try:
        report = msgspec.convert(value, _Report, from_attributes=True)
        position, *range_ = map(parse_time, (report.position, report.start, report.end))
    except (msgspec.ValidationError, RcpError) as error:
        raise Overrun(f"not the state of a replay: {error}") from error
    if not all(0 <= moment < _END for moment in (position, *range_)):
        raise Overrun("not the state of a replay: its times are out of range")
    if not 0 < report.speed <= _FASTEST:
        raise Overrun("not the state of a replay: its speed is out of range")
    begin, end = range_
    return _State(report.state, position, (begin, end), report.speed, report.jumps)


def _ignore(_reply: Reply) -> None:
    """Ignore a reply: there is nobody to tell it to."""
