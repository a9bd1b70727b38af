"""Calls of what a client offers, from others to it and back."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest
from rcp_kernel.wire import Reply, Request
from rcp_rosbridge.context import Context
from rcp_rosbridge.operations import ActionFeedback, ActionResult, ServiceResponse
from rcp_rosbridge.replies import complaint, plain

__all__ = ["OfferedCalls"]

_MOST = 4096  # calls that the client has not answered
_CANCELLED, _ABORTED = 5, 6
"""Of action_msgs/GoalStatus."""
_NOTHING = msgspec.Raw(b"{}")
_LONGEST = 2000  # characters of an error
_UNREAD = "the client that offers it does not read what it is sent"


class _Call:
    """A call that the client has been given."""

    __slots__ = ("feedback", "name", "place", "sending", "told")

    def __init__(self, name: str, place: str) -> None:
        self.name = name
        self.place = place
        """Path below which it is answered."""
        self.told = False
        """Whether the client was told to cancel it."""
        self.sending = False
        self.feedback: msgspec.Raw | None = None
        """The newest feedback, while the one before is on its way."""


class OfferedCalls:
    """The calls that one client carries out."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._calls: dict[str, _Call] = {}
        self._taking: set[str] = set()

    def renew(
        self, key: tuple[str, str], type_: str, place: str, waiting: dict[str, list[str]]
    ) -> None:
        """Give the client the calls that wait for it, and tell it which to cancel."""
        for id_ in waiting["calls"]:
            if id_ not in self._taking and id_ not in self._calls:
                self._taking.add(id_)
                self._take(id_, key, type_, place)
        for id_ in waiting["cancelled"]:
            call = self._calls.get(id_)
            if call is not None and not call.told:
                call.told = True
                told = {"op": "cancel_action_goal", "id": id_, "action": call.name}
                self._context.send(told)

    def _take(self, id_: str, key: tuple[str, str], type_: str, place: str) -> None:
        kind, name = key

        def answer(reply: Reply) -> None:
            if not reply.final:
                return
            self._taking.discard(id_)
            if reply.error is not None:  # who called has gone
                return
            args = plain(reply)["input"]
            if len(self._calls) >= _MOST:  # nobody waits for these any more
                del self._calls[next(iter(self._calls))]
            self._calls[id_] = _Call(name, place)
            message: dict[str, Any] = {"op": "call_service", "id": id_, "service": name}
            if kind == "action":
                message = {"op": "send_action_goal", "id": id_, "action": name}
                message |= {"action_type": type_, "feedback": True}
            if not self._context.send({**message, "args": {} if args is None else args}):
                self._end(id_, {"error": _UNREAD})

        self._do(place, "take", {"call": id_}, answer)

    def respond(self, op: ServiceResponse) -> None:
        """Pass on the response of a service.

        :raises BadRequest: nothing waits for it.
        """
        values = op.values or _NOTHING
        self._end(
            self._known(op.id_, op.service),
            {"output": values} if op.result else _failure(values, f"{op.service} has failed"),
        )

    def feedback(self, op: ActionFeedback) -> None:
        """Pass on feedback of an action; the newest replaces what waits.

        :raises BadRequest: nothing waits for it.
        """
        id_ = self._known(op.id_, op.action)
        call = self._calls[id_]
        call.feedback = op.values or _NOTHING
        if not call.sending:
            self._send_feedback(id_, call)

    def _send_feedback(self, id_: str, call: _Call) -> None:
        values, call.feedback = call.feedback, None
        call.sending = True

        def answer(reply: Reply) -> None:
            if reply.final:
                call.sending = False
                if call.feedback is not None and id_ in self._calls:
                    self._send_feedback(id_, call)

        self._do(call.place, "respond", {"call": id_, "feedback": values, "done": False}, answer)

    def finish(self, op: ActionResult) -> None:
        """Pass on the result of an action.

        :raises BadRequest: nothing waits for it.
        """
        values = op.values or _NOTHING
        id_ = self._known(op.id_, op.action)
        if op.status == _CANCELLED:
            self._end(id_, {"cancelled": True, "output": values})
        elif op.status == _ABORTED or not op.result:
            self._end(id_, _failure(values, f"{op.action} has failed"))
        else:
            self._end(id_, {"output": values})

    def _known(self, id_: object, name: str) -> str:
        found = str(id_)
        if found not in self._calls:
            raise BadRequest(
                f"no call of {name} with the id '{found[:64]}' waits for an answer",
                remedy="Repeat the `id` of the call; its caller may have cancelled it.",
            )
        return found

    def _end(self, id_: str, outcome: dict[str, Any]) -> None:
        call = self._calls.pop(id_)

        def answer(reply: Reply) -> None:
            if reply.error is not None:
                text = f"{call.name}: {complaint(reply)}"
                self._context.status.warning(text, id_, f"answer {call.name}")

        self._do(call.place, "respond", {"call": id_, **outcome}, answer)

    def _do(self, place: str, name: str, body: dict[str, Any], answer: Any) -> None:
        path = f"{place}/{name}"
        raw = msgspec.Raw(msgspec.json.encode(body))
        self._context.request(Request(type="execute", path=path, body=raw), answer)


def _failure(values: msgspec.Raw, text: str) -> dict[str, Any]:
    """Return the outcome of a call that has failed: with its text as the reason, if it is one."""
    found = msgspec.json.decode(values)
    if isinstance(found, str) and found:
        return {"error": found[:_LONGEST]}
    return {"error": text, "output": values}
