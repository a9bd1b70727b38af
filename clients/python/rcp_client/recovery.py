"""Recovery of requests and subscriptions after a lost connection.

A resumed session reports the outcome of accepted commands by itself; other requests may have been
lost.

If the session is resumed, the gateway still knows every idempotency key, possibly from its store,
so that a repeated request is executed once. The same holds for a new session on the same gateway. A
restarted gateway does not know the keys: then the outcome of a command is looked up, and nothing is
repeated. A hub knows no keys of another hub, or of its own earlier run, but the robots' gateways
behind it know those of what concerns robots. Of a batch nothing is repeated there.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol

from rcp_client.calls import Call, Calls
from rcp_client.errors import ConnectionLost, error_of
from rcp_client.messages import Reply
from rcp_client.requests import concerns_gateway
from rcp_client.subscriber import Subscriber
from rcp_client.tries import Tries
from rcp_protocol.clock import iso, now, parse_time
from rcp_protocol.errors import AdapterUnavailable, RcpError, UnknownPath

__all__ = ["Recovery", "Requests"]

_ROUNDED = 0.001  # s: as exactly as the gateway tells for how long it has been running
_DRIFT = 1e-4  # of a time, by which two computers measure it differently


class Requests(Protocol):
    """The unanswered requests, and how to send them again."""

    @property
    def calls(self) -> Calls:
        """Requests in flight."""
        ...

    @property
    def subscriptions(self) -> Mapping[str, Subscriber]:
        """Subscriptions by id."""
        ...

    def calls_of_before(self) -> list[Call]:
        """List the calls that were not sent on the current connection."""
        ...

    def is_current(self, link: object) -> bool:
        """Return whether this is the connection in use, and its handshake is complete."""
        ...

    def send(self, call: Call, **facts: Any) -> None:
        """Send a call again, with additional fields."""

    async def ask(self, envelope: dict[str, Any]) -> Reply:
        """Send a request and return its final reply, within its deadline."""
        ...


class Recovery:
    """Transfers calls and subscriptions to a new connection."""

    def __init__(self, requests: Requests, patience: float | None) -> None:
        self._requests, self._patience = requests, patience
        self._repeats: set[asyncio.Task[None]] = set()
        self._met: int | None = None
        """When the gateway was last known to be the same, ns by its own clock."""
        self._met_at = float("-inf")
        """The same by `time.monotonic` here: the gateway's clock may be set back before it starts anew."""
        self._offset = 0
        """Offset of the gateway's clock from ours, ns."""
        self._doubt = False
        """A new session has started, and pending calls have not been settled yet."""
        self._moved = False
        """It has started at another address, perhaps that of another hub."""

    def greeted(self, timestamp: str, requested: int, *, resumed: bool, moved: bool) -> None:
        """Record a handshake: its time there, and when it was requested here."""
        there = parse_time(timestamp)
        self._offset = there - (requested + now()) // 2
        if self._met is None:
            self._met, self._met_at = there, time.monotonic()
        elif not resumed:
            self._doubt = True
            self._moved = self._moved or moved

    async def restore(self) -> None:
        """Transfer everything; if interrupted by another lost connection, it is repeated."""
        requests = self._requests
        restarted, outside = await self._look() if self._doubt else (False, False)
        for subscription in list(requests.subscriptions.values()):
            subscription.restore(restarted=restarted or self._moved)
        lost: list[Call] = []
        for call in requests.calls_of_before():
            if call.sent is None or call.repeat == "always":
                requests.send(call)
            elif call.repeat == "keyed" and self._is_known(call, restarted, outside):
                if restarted or self._moved:
                    requests.calls.forget_command(call)
                    tries = Tries(self._patience)
                    call.on_refusal = partial(self._refused, call, tries)
                self._again(call)
            else:
                lost.append(call)
        if lost:
            await self._look_up(lost, keys=not (restarted or self._moved))
        if restarted:
            self._met, self._met_at = now() + self._offset, time.monotonic()
        self._doubt = self._moved = False

    def _is_known(self, call: Call, restarted: bool, outside: bool) -> bool:  # noqa: FBT001 - internal
        """Return whether whoever carries out a call still knows its key.

        `outside` tells that robots' own gateways know the keys of what concerns robots.
        """
        if not (restarted or self._moved):
            return True
        # Some parts of a batch may have been carried out before; the refusal of a part of its
        # repeat would not say so.
        is_batch = call.envelope["type"] == "batch"
        return outside and not is_batch and not concerns_gateway(call.envelope)

    def _refused(self, call: Call, tries: Tries, reply: Reply) -> None:
        """Repeat a call again whose robot this gateway does not reach yet.

        Any other refusal does not tell whether the call was carried out through the gateway before.
        """
        error = error_of(reply)
        assert error is not None
        if isinstance(error, (AdapterUnavailable, UnknownPath)) and call.repeat != "never":
            task = asyncio.create_task(self._later(call, tries, error), name="rcp repeat")
            self._repeats.add(task)
            task.add_done_callback(self._repeats.discard)
        else:
            self._fail(call, error)

    async def _later(self, call: Call, tries: Tries, error: RcpError) -> None:
        link, calls = call.link, self._requests.calls
        if not await tries.again(error):
            self._fail(call, error)
        elif self._requests.is_current(link) and call in calls:  # else `restore` judges it
            if call.repeat == "never":  # its caller has given it up meanwhile
                self._fail(call, error)
            else:
                self._again(call)

    def _fail(self, call: Call, error: RcpError) -> None:
        error.status = "failed"  # it may have been carried out through another gateway
        call.fail(call.unanswered(error))
        self._requests.calls.leave(call)

    def close(self) -> None:
        """Repeat nothing any more."""
        for task in self._repeats:
            task.cancel()

    def _again(self, call: Call) -> None:
        facts: dict[str, Any] = {}
        if (deadline := call.envelope.get("deadline")) is not None:
            facts["deadline"] = max(0.1, deadline - (time.monotonic() - call.started))
        if call.envelope["type"] != "batch" and "timestamp" not in call.envelope:
            # By the gateway's clock, so that a command that never arrived is not executed too late.
            facts["timestamp"] = iso((call.sent or now()) + self._offset)
        self._requests.send(call, **facts)

    async def _look(self) -> tuple[bool, bool]:
        """Return whether the gateway may have been restarted, and whether its robots have their own.

        A restart counts since the first connection. Both what the clocks show and for how long the
        gateway has been running must say that there was none: clocks may be set, and this machine may
        have been suspended.
        """
        body = {"fields": ["started", "uptime", "backends"]}
        known_for = time.monotonic() - self._met_at
        envelope: dict[str, Any] = {"type": "read", "path": "/system/status", "body": body}
        try:
            reply = await self._requests.ask(envelope)
            started, uptime = parse_time(reply.body["started"]), float(reply.body["uptime"])
            backends: list[dict[str, Any]] = reply.body["backends"]
        except (RcpError, KeyError, TypeError, ValueError):
            return True, False
        outside = bool(backends) and all(one.get("gateways") for one in backends)
        young = uptime + _ROUNDED + _DRIFT * known_for < known_for
        anew = self._met is None or started > self._met or young
        return anew, outside

    async def _look_up(self, lost: list[Call], *, keys: bool) -> None:
        """Look up the outcome of commands that must not be sent again."""
        known: dict[str, dict[str, Any]] = {}
        try:
            reply = await self._requests.ask({"type": "read", "path": "/system/commands"})
            for item in reply.body:
                known[item["command"]] = item
                known.setdefault(item.get("id", ""), item)
        except (RcpError, KeyError, TypeError):
            pass  # not visible to this principal: nothing is known
        for call in lost:
            found = next((known[k] for k in (call.command, *call.ids) if k in known), None)
            if found is not None:
                call.take(_reply_of(found))
            error = ConnectionLost(
                "the connection was lost before the reply; it is unknown whether the request was "
                "executed",
                path=call.envelope.get("path"),
            )
            call.fail(call.unanswered(error, keys=keys))
            self._requests.calls.leave(call)


def _reply_of(command: dict[str, Any]) -> Reply:
    """Convert a command's state in `/system/commands` to the missed reply."""
    names = ("path", "status", "body", "message", "error", "command", "progress")
    facts = {name: command[name] for name in names if name in command}
    return Reply(type="execute", timestamp=command.get("updated"), **facts)
