"""One robot's session at the gateway: requests, commands that can be cancelled, subscriptions, control."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any

import msgspec
import structlog

from rcp_gateway.api import Connection
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import RcpError
from rcp_kernel.values import Encoding
from rcp_vda5050.config import RobotConfig

__all__ = ["Link", "NotStoppedError", "Running"]

log = structlog.get_logger("rcp.vda5050")
_LEASES = "/system/leases"
_TTL, _RENEW = 10.0, 3.0  # s
_AGAIN = 5.0  # s until a key that was refused is tried again
_LOST: dict[str, Any] = {
    "status": "failed",
    "error": {
        "code": "unauthenticated",
        "message": "the session of the fleet manager's key has ended",
    },
}
_PATIENCE = 30.0  # s for a cancelled command to end
_FINAL = frozenset({"completed", "failed", "cancelled", "rejected"})


class NotStoppedError(Exception):
    """A cancelled command was not confirmed to have stopped."""


class Running:
    """A request; `cancel` may come before the gateway has named its command."""

    def __init__(self, link: Link, then: Callable[[dict[str, Any]], None] | None) -> None:
        self._link, self._then = link, then
        self._command: str | None = None
        self.cancelled = False
        """Whether it was cancelled from here."""
        self._done: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()

    async def result(self) -> dict[str, Any]:
        """Return its last reply. Who is cancelled here cancels it, and waits for its end."""
        try:
            return await asyncio.shield(self._done)
        except asyncio.CancelledError:
            self.cancel()
            await self._see_end()
            raise

    async def _see_end(self) -> None:
        """Wait until the robot has confirmed the cancel.

        :raises NotStoppedError: it has not.
        """
        # Not `asyncio.timeout`: in a task that is being cancelled, Python 3.11.2 raises no TimeoutError.
        done, _ = await asyncio.wait((self._done,), timeout=_PATIENCE)
        if not done:
            raise NotStoppedError(f"it has not ended within {_PATIENCE:g} s")
        reply = self._done.result()
        if reply["status"] == "failed":
            raise NotStoppedError(reply["error"]["message"])

    def cancel(self) -> None:
        """Cancel it; `result` tells when it has ended."""
        if not self.cancelled:
            self.cancelled = True
            self._ask()

    def hear(self, reply: dict[str, Any]) -> None:
        """Take one of its replies."""
        self._command = reply.get("command", self._command)
        if reply["status"] in _FINAL:
            if not self._done.done():
                self._done.set_result(reply)
                if self._then is not None:
                    self._then(reply)
        else:
            self._ask()

    def _ask(self) -> None:
        if self.cancelled and self._command is not None and not self._done.done():
            self._link.send("cancel", None, None, command=self._command)


class Link:
    """The session of the fleet manager's key; begins anew when it ends."""

    def __init__(
        self,
        config: RobotConfig,
        client_api: ClientApi,
        topics: tuple[str, ...],
        heard: Callable[[str, Any], None],
    ) -> None:
        self._config, self._client_api = config, client_api
        self._topics, self._heard = topics, heard
        self._ids = itertools.count(1)
        self._running: dict[str, Running] = {}
        self._subscriptions: dict[str, str] = {}
        self._connection = self._connected()
        self._again: asyncio.TimerHandle | None = None
        self._keeping: asyncio.TimerHandle | None = None
        self._lease: str | None = None

    def _connected(self) -> Connection:
        """Open a session with the rights that the key has now.

        :raises RcpError: it is not known, or has no role in the tenant.
        """
        principal = self._client_api.authenticate(self._config.token)
        return self._client_api.connect(
            principal, Encoding.MSGPACK, self._flush, self._config.tenant
        )

    def open(self) -> None:
        """Subscribe to what the fleet manager wants to know."""
        self._subscriptions.clear()
        for path in self._topics:
            id_ = f"s{next(self._ids)}"
            self._subscriptions[id_] = path
            self._send({"type": "subscribe", "id": id_, "path": path})

    async def close(self) -> None:
        """Give control back and end the session."""
        for timer in (self._again, self._keeping):
            if timer is not None:
                timer.cancel()
        if not self._connection.expelled:
            await self.release()
        self._connection.close()

    # Requests

    def send(
        self,
        type_: str,
        path: str | None,
        body: Any,
        then: Callable[[dict[str, Any]], None] | None = None,
        **more: Any,
    ) -> Running:
        """Send a request; `then` is called with its last reply."""
        running = Running(self, then)
        id_ = f"r{next(self._ids)}"
        self._running[id_] = running
        message = {"type": type_, "id": id_, **more}
        message |= {} if path is None else {"path": path}
        message |= {} if body is None else {"body": body}
        self._send(message)
        return running

    def _send(self, message: dict[str, Any]) -> None:
        if self._connection.expelled:
            self._lose()
        else:
            self._connection.receive(msgspec.msgpack.encode(message))

    # Control

    async def control(self) -> dict[str, Any] | None:
        """Take control of the robot, or keep it; return the error if that is refused."""
        body = {
            "do": "acquire",
            "scope": self._config.robot,
            "ttl": _TTL,
            "reason": "carries out an order",
        }
        reply = await self.send("execute", _LEASES, body).result()
        if reply["status"] == "completed":
            self._lease = reply["body"]["lease"]
            self._keep()
            return None
        if reply["error"]["code"] == "unknown_path":  # a gateway without leases
            return None
        return reply["error"]

    def _keep(self) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
        self._keeping = self._client_api.loop.call_later(_RENEW, self._renew)

    def _renew(self) -> None:
        if self._lease is not None:
            # Not acquired again: what somebody took, or a stop ended, is asked for by an order alone.
            body = {"do": "renew", "lease": self._lease, "ttl": _TTL}
            self.send("execute", _LEASES, body, then=self._renewed)
            self._keep()

    def _renewed(self, reply: dict[str, Any]) -> None:
        if reply["status"] != "completed":
            self._lease = None

    async def release(self) -> None:
        """Give control back."""
        lease, self._lease = self._lease, None
        if lease is not None:
            await self.send("execute", _LEASES, {"do": "release", "lease": lease}).result()

    # From the gateway

    def _flush(self) -> None:
        if self._connection.expelled:
            self._lose()
            if self._again is None:
                self._connection.close()
                self._again = self._client_api.loop.call_later(_AGAIN, self._reconnect)
            return
        outbox = self._connection.outbox
        for message in outbox.collect():
            try:
                self._hear(msgspec.msgpack.decode(message))
            except Exception:  # of one message: the next one may be the end of a drive
                log.exception("message_failed", robot=self._config.robot)
        outbox.again()

    def _hear(self, message: dict[str, Any]) -> None:
        match message.get("type"):
            case "update":
                path = self._subscriptions.get(message.get("id", ""))
                if path is not None:
                    self._heard(path, message.get("body"))
            case "subscribe":
                if message.get("error") is not None:
                    self._heard(self._subscriptions[message["id"]], None)
            case "notice" | None:
                pass
            case _:
                running = self._running.get(message.get("id", ""))
                if running is not None:
                    if message["status"] in _FINAL:
                        del self._running[message["id"]]
                    running.hear(message)

    def _lose(self) -> None:
        """End what runs: its session, and so its control, has ended."""
        self._lease = None
        running, self._running = self._running, {}
        for each in running.values():
            each.hear(_LOST)

    def _reconnect(self) -> None:
        self._again = None
        try:
            self._connection = self._connected()
        except RcpError as error:
            log.warning("fleet_manager_refused", robot=self._config.robot, reason=str(error))
            self._again = self._client_api.loop.call_later(_AGAIN, self._reconnect)
            return
        self.open()
