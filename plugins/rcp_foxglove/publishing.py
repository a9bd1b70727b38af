"""What clients publish: writes to actuators, one after the other, the newest ones if there are many."""

from __future__ import annotations

from collections import deque

from rcp_foxglove.leases import Leases
from rcp_foxglove.offers import Target
from rcp_foxglove.operations import ClientChannel
from rcp_foxglove.requests import Requests, body_of
from rcp_foxglove.statuses import WARNING, Statuses, refusal_text
from rcp_foxglove.views import View
from rcp_kernel.errors import BadRequest, RcpError, UnknownPath
from rcp_kernel.wire import Reply, Request

__all__ = ["Publishing"]

_WAITING = 16  # messages of a channel while the robot is still busy with an earlier one
_CHANNELS = 1000
_BYTES = 4 * 1024 * 1024  # of all that wait, beside the message that each channel may have
_LISTED = 10


class _Channel:
    def __init__(self, facts: ClientChannel, target: Target | None) -> None:
        self.facts = facts
        self.target = target
        self.waiting: deque[tuple[bytes, float]] = deque()
        """Payloads, each with the time of its receipt by the loop's clock."""
        self.busy = False
        self.skipped = 0

    @property
    def status(self) -> str:
        return f"publish:{self.facts.topic}"


class Publishing:
    """The channels on which one client publishes."""

    def __init__(
        self, requests: Requests, leases: Leases, statuses: Statuses, valid_for: float | None
    ) -> None:
        self._requests = requests
        self._leases = leases
        self._statuses = statuses
        self._valid_for = valid_for
        self._channels: dict[int, _Channel] = {}
        self._size = 0

    @property
    def topics(self) -> set[str]:
        """The topics that the client publishes on."""
        return {one.facts.topic for one in self._channels.values() if one.target is not None}

    def advertise(self, facts: ClientChannel, view: View) -> None:
        """Begin a channel; if nothing can be published on it, say so now."""
        if facts.id in self._channels:
            self._statuses.tell(f"The client channel {facts.id} is already advertised.", WARNING)
            return
        if len(self._channels) >= _CHANNELS:
            self._statuses.tell(f"A client has at most {_CHANNELS} channels.")
            return
        channel = self._channels[facts.id] = _Channel(facts, None)
        self._place(channel, view)
        if channel.target is not None:
            self._leases.begin(channel.target.path)

    def renew(self, view: View) -> None:
        """Apply another view of the tree."""
        for channel in self._channels.values():
            self._place(channel, view)

    def _place(self, channel: _Channel, view: View) -> None:
        channel.target = None
        try:
            channel.target = _target(channel.facts, view)
        except RcpError as error:
            self._statuses.show(channel.status, refusal_text(error))
        else:
            self._statuses.remove(channel.status)

    def unadvertise(self, number: int) -> None:
        """End a channel."""
        channel = self._channels.pop(number, None)
        if channel is None:
            self._statuses.tell(f"There is no client channel {number}.", WARNING)
            return
        while channel.waiting:
            self._pop(channel)
        self._statuses.remove(channel.status)
        if channel.target is not None:
            self._leases.release(channel.target.path)

    def publish(self, number: int, payload: bytes) -> None:
        """Write a message to the actuator of its channel."""
        channel = self._channels.get(number)
        if channel is None:
            self._statuses.tell(f"There is no client channel {number}: advertise it first.")
            return
        if channel.target is None:
            return  # the reason is shown
        channel.waiting.append((payload, self._now()))
        self._size += len(payload)
        if channel.busy:
            # Of velocities only the newest one matters, and an old one must not come late.
            most = 1 if channel.target.deadman or self._size > _BYTES else _WAITING
            while len(channel.waiting) > most:
                self._pop(channel)
                channel.skipped += 1
            return
        channel.busy = True
        self._requests.begin(self._write_all(channel))

    async def _write_all(self, channel: _Channel) -> None:
        try:
            while channel.waiting and channel.target is not None:
                payload, received = self._pop(channel)
                await self._write(channel, channel.target, payload, received)
        finally:
            channel.busy = False

    def _pop(self, channel: _Channel) -> tuple[bytes, float]:
        first = channel.waiting.popleft()
        self._size -= len(first[0])
        return first

    async def _write(
        self, channel: _Channel, target: Target, payload: bytes, received: float
    ) -> None:
        window = (self._valid_for or target.valid_for) if target.deadman else None
        try:
            body, encoding = await body_of(
                self._requests, channel.facts.encoding, payload, target.native
            )
            await self._leases.keep(target.path)
            request = Request(type="write", path=target.path, body=body, encoding=encoding)
            reply = await self._sent(request, window, received)
            if reply is not None and _lacks_lease(reply) and self._leases.may_acquire(target.path):
                refusal = await self._leases.acquire(target.path)
                reply = refusal or await self._sent(request, window, received)
        except RcpError as error:
            self._statuses.show(channel.status, f"{channel.facts.topic}: {refusal_text(error)}")
            return
        if reply is None:
            channel.skipped += 1
        else:
            self._show(channel, reply)

    async def _sent(self, request: Request, window: float | None, received: float) -> Reply | None:
        """Send a write; None: what it commands has waited too long to act any longer."""
        if window is not None:
            request.valid_for = window - (self._now() - received)
            if request.valid_for <= 0:
                return None
        return await self._requests.request(request)

    def _now(self) -> float:
        return self._requests.client_api.loop.time()

    def _show(self, channel: _Channel, reply: Reply) -> None:
        topic, skipped = channel.facts.topic, channel.skipped
        if reply.error is not None:
            self._statuses.show(channel.status, f"{topic}: {refusal_text(reply)}")
        elif skipped:
            channel.skipped = 0
            text = f"{topic}: {skipped} messages were skipped, because the robot was slower."
            self._statuses.show(channel.status, text, WARNING)
        elif not channel.waiting:
            self._statuses.remove(channel.status)


def _lacks_lease(reply: Reply) -> bool:
    return reply.error is not None and reply.error["code"] in ("lease_required", "lease_lost")


def _target(facts: ClientChannel, view: View) -> Target:
    """Return where a channel's messages go.

    :raises UnknownPath: there is no such topic to publish on.
    :raises BadRequest: it does not take the channel's encoding.
    """
    target = view.targets.get(facts.topic)
    if target is None:
        known = sorted({one.topic for one in view.targets.values()})
        more = ", …" if len(known) > _LISTED else ""
        raise UnknownPath(
            f"nothing accepts messages on {facts.topic!r}",
            remedy=f"Publish on one of: {', '.join(known[:_LISTED])}{more}"
            if known
            else "Use a key that may write to an actuator.",
        )
    encodings = ["json"]
    if target.native is not None and target.native.decode is not None:
        encodings.append(target.native.encoding)
    if facts.encoding not in encodings:
        raise BadRequest(
            f"{facts.topic} does not accept the encoding {facts.encoding!r}",
            remedy=f"Use {' or '.join(encodings)}.",
        )
    return target
