"""Exclusive control of a part of the tree during a block, renewed automatically."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any, Self

from rcp_client.channel import Channel
from rcp_client.messages import Notice, Reply
from rcp_protocol.clock import parse_time
from rcp_protocol.errors import LeaseHeld, LeaseLost, LeaseRequired, RcpError
from rcp_protocol.timeouts import timeout, timeout_at

__all__ = ["Lease"]

_PATH = "/system/leases"
_RENEWALS = 3  # renewals per lifetime


class Lease:
    """A lease: acquired on entering, renewed while inside, and released on leaving.

    Losing it cancels the block, which then raises `LeaseLost` with the reason. At another hub of a
    fleet it is acquired again, before anything else is sent there.
    """

    def __init__(self, channel: Channel, body: dict[str, Any]) -> None:
        self._channel = channel
        self._asked = body
        self.facts: dict[str, Any] = {}
        """The last known state of the lease: `lease`, `scope`, `holder`, `expires`, …"""
        self.lost: LeaseLost | None = None
        """Why the lease was lost, once it is."""
        self._until = 0.0
        """When it expires unless it is renewed, event loop time in s."""
        self._home = channel.address
        """Where it was acquired."""
        self._moved = asyncio.Event()
        self._keeper: asyncio.Task[None] | None = None
        self._block: asyncio.Task[Any] | None = None
        self._cutting = False
        """Whether the block was cancelled because the lease was lost."""

    async def open(self) -> None:
        """Acquire the lease and start to renew it.

        :raises LeaseHeld: another client holds it and does not give way.
        """
        self._take_note(await self._ask({"do": "acquire", **self._asked}))
        self._channel.listeners.append(self._noticed)
        self._keeper = asyncio.create_task(self._keep(), name="rcp lease")

    async def close(self) -> None:
        """Release the lease, if it still exists."""
        if self._noticed in self._channel.listeners:
            self._channel.listeners.remove(self._noticed)
        if self._keeper is not None:
            self._keeper.cancel()
        if self.lost is None and self._channel.connected:
            with suppress(RcpError):  # a lease that cannot be released expires
                await self._ask({"do": "release", "lease": self.facts["lease"]})

    async def __aenter__(self) -> Self:
        self._block = asyncio.current_task()
        await self.open()
        return self

    async def __aexit__(self, type_: type[BaseException] | None, *_: object) -> None:
        block, self._block = self._block, None
        await self.close()
        if self.lost is None or block is None:
            return
        cut = type_ is not None and issubclass(type_, asyncio.CancelledError)
        if self._cutting:
            if not cut:  # the block has ended by itself in the meantime
                with suppress(asyncio.CancelledError):
                    await asyncio.sleep(0)
            if block.uncancel():  # cancelled by the caller as well
                return
        if type_ is None or (cut and self._cutting):
            raise self.lost

    def check(self) -> None:
        """Check that the lease is still held.

        :raises LeaseLost: it is not.
        """
        if self.lost is not None:
            raise self.lost

    async def hand_over(self, to: str) -> dict[str, Any]:
        """Hand the lease, with the commands that run under it, over to a principal or session."""
        body = {"do": "hand_over", "lease": self.facts["lease"], "to": to}
        given = (await self._ask(body)).body
        self._lose(LeaseLost(f"the lease was handed over to {given['holder']}"))
        return given

    async def _ask(self, body: dict[str, Any]) -> Reply:
        return await self._channel.ask({"type": "execute", "path": _PATH, "body": body})

    def _take_note(self, reply: Reply) -> None:
        self.facts, self._home = reply.body, self._channel.address
        left = (parse_time(reply.body["expires"]) - parse_time(reply.timestamp or 0)) / 1e9
        self._until = asyncio.get_running_loop().time() + left

    async def _keep(self) -> None:
        loop = asyncio.get_running_loop()
        while self.lost is None:
            with suppress(TimeoutError):
                async with timeout((self._until - loop.time()) / _RENEWALS):
                    await self._moved.wait()
            self._moved.clear()
            home = self._channel.address
            try:
                async with timeout_at(self._until):
                    self._take_note(await self._ask(self._again()))
            except (LeaseLost, LeaseRequired, LeaseHeld) as error:
                if self._channel.address != home:  # it was asked of a hub that knows nothing of it
                    self._moved.set()
                    continue
                self._lose(LeaseLost(error.message, remedy=error.remedy, details=error.details))
            except TimeoutError:
                self._lose(LeaseLost("the lease expired: the gateway could not be reached in time"))
            except RcpError:  # probably a lost connection: there may be time for another attempt
                if loop.time() >= self._until:
                    self._lose(LeaseLost("the lease expired: it could not be renewed"))

    def _again(self) -> dict[str, Any]:
        if self._channel.address != self._home:
            return {"do": "acquire", **self._asked}
        again = {"do": "renew", "lease": self.facts["lease"], "ttl": self._asked.get("ttl")}
        return {key: item for key, item in again.items() if item is not None}

    def _noticed(self, notice: Notice) -> None:
        facts = notice.facts
        if notice.code == "reconnected" and self._channel.address != self._home:
            self._moved.set()
        if notice.code == "lease_lost" and facts.get("lease") == self.facts["lease"]:
            by, reason = facts.get("by"), facts.get("reason")
            text = f"the lease on {facts.get('scope')} was lost: {reason} (by {by})"
            self._lose(LeaseLost(text, details={"by": by, "reason": reason}))

    def _lose(self, error: LeaseLost) -> None:
        if self.lost is None:
            self.lost = error
            if self._block is not None and self._block is not asyncio.current_task():
                self._cutting = True
                self._block.cancel()
