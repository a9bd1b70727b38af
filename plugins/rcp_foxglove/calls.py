"""Calls of services and actions."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_foxglove.frames import Call, call_response
from rcp_foxglove.offers import Service
from rcp_foxglove.requests import UNREAD, Requests, body_of
from rcp_foxglove.statuses import refusal_text
from rcp_foxglove.views import ESTOP, View
from rcp_kernel.errors import QueueFull, RcpError, UnknownPath
from rcp_kernel.values import Encoding
from rcp_kernel.wire import NO_BODY, Reply, Request, encode_body
from rcp_ros_messages import refused_response

__all__ = ["Calls"]

_AT_ONCE = 256


class Calls:
    """The calls of one client."""

    def __init__(self, requests: Requests, put: Any, timeout: float | None) -> None:
        self._requests = requests
        self._put = put
        self._timeout = timeout
        self._running = 0

    def call(self, call: Call, view: View) -> None:
        """Call a service; its response or the reason why there is none follows."""
        service = view.services.get(call.service)
        if service is None:
            self._fail(call, refusal_text(UnknownPath(f"service {call.service} does not exist")))
        elif self._running >= _AT_ONCE and service.path != ESTOP:
            error = QueueFull(f"{self._running} calls of this client are not answered yet")
            self._fail(call, refusal_text(error))
        else:
            self._running += 1
            self._requests.begin(self._call(call, service))

    async def _call(self, call: Call, service: Service) -> None:
        try:
            native = service.natives.get("input")
            body, encoding = await body_of(self._requests, call.encoding, call.payload, native)
            request = Request(
                type="execute",
                path=service.path,
                body=body,
                encoding=encoding,
                deadline=self._timeout,
            )
            reply = await self._requests.request(request)
            answered = refused_response(reply.error)
            if answered is not None:
                self._respond(call, _encoded(call, service, answered))
            elif reply.error is not None or reply.status != "completed":
                self._fail(call, refusal_text(reply))
            else:
                self._respond(call, _result(call, service, reply))
        except RcpError as error:
            self._fail(call, refusal_text(error))
        finally:
            self._running -= 1

    def _respond(self, call: Call, result: bytes) -> None:
        if not self._requests.reply(call_response(call, result)):
            self._fail(call, f"The call ended, but its response was dropped because {UNREAD}.")

    def _fail(self, call: Call, reason: str) -> None:
        facts = {
            "op": "serviceCallFailure",
            "serviceId": call.service,
            "callId": call.id,
            "message": reason,
        }
        self._put(msgspec.json.encode(facts))


def _result(call: Call, service: Service, reply: Reply) -> bytes:
    """Return the result in the encoding of the call."""
    if call.encoding == "json":
        return b"{}" if reply.body is NO_BODY else encode_body(reply.body, Encoding.JSON)
    value = None if reply.body is NO_BODY else getattr(reply.body, "value", reply.body)
    return _encoded(call, service, value)


def _encoded(call: Call, service: Service, value: Any) -> bytes:
    if call.encoding == "json":
        return msgspec.json.encode(value)
    encode = service.natives["output"].encode
    assert encode is not None
    return encode(value)
