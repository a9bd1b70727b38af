"""One service or action that a client offers, with its calls."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from typing import Any

from rcp_offers.call import Call, Report
from rcp_offers.messages import Answer, Offer, Waiting
from rcp_protocol.errors import (
    AdapterUnavailable,
    Cancelled,
    DeviceRejected,
    DeviceTimeout,
    QueueFull,
    RcpError,
)

__all__ = ["Offered", "Owner"]

_CANCEL = 4.0  # s for the client to confirm a cancel: less than commands wait for it


Owner = tuple[str, str] | None
"""The identity of a principal: the same name, proved in another way, is somebody else."""


class Offered:
    """What a client offers, while it does."""

    def __init__(
        self, offer: Offer, owner: Owner, tell: Callable[[Waiting], None], most: int
    ) -> None:
        """`tell` sends the client what waits; at most `most` calls do."""
        self.offer = offer
        self.owner = owner
        """The principal that offers it."""
        self.calls: dict[str, Call] = {}
        self._tell = tell
        self._most = most
        self._gone: RcpError | None = None
        self._idle = asyncio.Event()

    async def call(self, input_: Any, report: Report) -> Any:
        """Have the client carry out a call; return its result.

        :raises AdapterUnavailable: the client has gone.
        :raises DeviceRejected: the client says that it failed.
        :raises QueueFull: too many calls wait.
        """
        if self._gone is not None:
            raise self._gone
        if len(self.calls) >= self._most:
            raise QueueFull(
                f"{len(self.calls)} calls of {self.offer.name} wait for the client that offers it",
                remedy="Try again when they are answered.",
                retry_after=1,
            )
        call = Call(secrets.token_hex(8), input_, report)
        self.calls[call.id] = call
        self._renew()
        try:
            return await asyncio.shield(call.answer)  # which a cancel must still wait for
        except asyncio.CancelledError:
            if call.taken and self.offer.kind == "action" and not call.answer.done():
                return await self._cancel(call)
            raise
        finally:
            del self.calls[call.id]
            if self._gone is not None and not self.calls:
                self._idle.set()
            elif not call.taken:
                self._renew()

    async def _cancel(self, call: Call) -> Any:
        """Have the client cancel a call; it may also end in another way."""
        call.cancelled = True
        self._renew()
        # Not `asyncio.timeout`: in a task that is being cancelled, Python 3.11.2 raises no TimeoutError.
        done, _ = await asyncio.wait((call.answer,), timeout=_CANCEL)
        if not done:
            raise DeviceTimeout(
                f"the client that offers {self.offer.name} has not confirmed the cancel"
            )
        try:
            return call.answer.result()
        except Cancelled:
            raise asyncio.CancelledError from None

    def take(self, call: Call) -> None:
        """Note that the client has begun with a call: it may have effects from now on."""
        call.taken = True
        call.report()

    def settle(self, call: Call, answer: Answer) -> None:
        """Pass on what the client says of a call."""
        if call.answer.done():
            return
        if not answer.done:
            call.report(answer.feedback, fraction=answer.progress)
        elif answer.cancelled:
            call.answer.set_exception(Cancelled(f"{self.offer.name} was cancelled"))
        elif answer.error is not None:
            details = None if answer.output is None else {"output": answer.output}
            call.answer.set_exception(DeviceRejected(answer.error, details=details))
        else:
            call.answer.set_result(answer.output)

    def close(self) -> None:
        """End all calls: the client has gone, or withdraws its offer."""
        self._gone = self._unavailable()
        for call in self.calls.values():
            if not call.answer.done():
                call.answer.set_exception(self._unavailable())

    async def closed(self) -> None:
        """End all calls, and wait until they have told why."""
        self.close()
        if self.calls:
            await self._idle.wait()
        await asyncio.sleep(0)  # the gateway learns it in the next turn of the loop

    def _unavailable(self) -> RcpError:
        return AdapterUnavailable(
            f"the client that offered {self.offer.name} has gone, or offers it no more",
            remedy="Try again when a client offers it.",
        )

    def _renew(self) -> None:
        if self._gone is None:
            calls = self.calls.values()
            self._tell(
                Waiting(
                    calls=[call.id for call in calls if not call.taken],
                    cancelled=[call.id for call in calls if call.cancelled],
                )
            )
