"""Performs actions: those of nodes and edges, of zones, and instant ones.

Blocking types (2.1 section 6.10.2): NONE goes on while others run and while driving, SOFT while others
run, SINGLE (3.0) while driving, HARD alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Literal

import structlog
from msgspec import Struct

from rcp_vda5050.config import ActionConfig, RobotConfig
from rcp_vda5050.link import Link
from rcp_vda5050.messages import Action
from rcp_vda5050.zone_messages import ZoneAction

__all__ = ["ENDED", "STOPS_DRIVING", "ActionState", "Own", "Performer"]

log = structlog.get_logger("rcp.vda5050")
ENDED = ("FINISHED", "FAILED")
STOPS_DRIVING = ("SOFT", "HARD")
_ALONE = ("SINGLE", "HARD")


Own = Mapping[str, Callable[[Action], Awaitable[str | None]]]
"""Actions of nodes that every robot does, by type; each returns why it cannot."""


class ActionState(Struct):
    """How far an action has come."""

    action: Action
    status: Literal["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "FINISHED", "FAILED"]
    result: str = ""
    ends_with_zone: bool = False
    """Whether it lasts as long as the robot is in a zone."""
    left: bool = False
    """Whether the robot has left that zone."""

    @property
    def lasts(self) -> bool:
        """Whether nothing waits for its end: it comes when the robot drives on."""
        return self.ends_with_zone and self.action.blocking_type not in STOPS_DRIVING


class Performer:
    """Performs the actions of one robot; `failed` is told of those that do not finish."""

    def __init__(
        self,
        config: RobotConfig,
        link: Link,
        own: Own,
        resumed: asyncio.Event,
        changed: Callable[[], None],
        failed: Callable[[ActionState, dict[str, Any]], None],
    ) -> None:
        self._config, self._link, self._resumed = config, link, resumed
        self._own = own
        self._changed, self._failed = changed, failed
        self._running: dict[asyncio.Task[None], ActionState] = {}

    @property
    def running(self) -> list[asyncio.Task[None]]:
        """What runs, without instant actions."""
        return list(self._running)

    @property
    def awaited(self) -> list[asyncio.Task[None]]:
        """What runs and ends by itself."""
        return [task for task, state in self._running.items() if not state.lasts]

    async def perform(self, states: Sequence[ActionState]) -> None:
        """Do the actions of a node, an edge or a zone; return when the robot may drive on."""
        waits = False
        for state in states:
            blocking = state.action.blocking_type
            if blocking in _ALONE:
                await self._all_done()
            await self._resumed.wait()
            if state.status != "WAITING":
                continue
            task = asyncio.get_running_loop().create_task(self.do(state))
            self._running[task] = state
            task.add_done_callback(self._did)
            if blocking in _ALONE:
                await self._all_done()
            waits = waits or blocking in STOPS_DRIVING
        if waits:
            await self._all_done()

    async def _all_done(self) -> None:
        while awaited := self.awaited:
            await asyncio.wait(awaited)

    def _did(self, task: asyncio.Task[None]) -> None:
        del self._running[task]
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("action_failed", robot=self._config.robot, exc_info=error)
        self._changed()

    def end_with_zone(self, states: Sequence[ActionState]) -> None:
        """End those of them that last as long as the robot is in a zone."""
        for task, state in self._running.items():
            if state.ends_with_zone and any(state is each for each in states):
                state.left = True
                task.cancel()
        for state in states:
            if state.ends_with_zone and state.status == "WAITING":
                state.status, state.result = "FAILED", "the robot has left the zone"

    async def do(self, state: ActionState) -> None:
        """Do an action; ended when the robot says so, also by a cancel."""
        state.status = "RUNNING"
        self._changed()
        try:
            error = await self._run(state)
            if error is None:
                state.status = "FINISHED"
                return
            state.result = error["message"]
            self._failed(state, error)
        except asyncio.CancelledError:
            if state.left:  # the robot has confirmed that it ended
                state.status = "FINISHED"
            raise
        finally:
            if state.status == "RUNNING":
                state.status = "FAILED"
            self._changed()

    async def _run(self, state: ActionState) -> dict[str, Any] | None:
        """Run an action to its end; return why it failed."""
        kind = state.action.action_type
        what = self._config.actions.get(kind)
        if what is None:
            reason = await self._own[kind](state.action)
            return None if reason is None else {"code": "failed", "message": reason}
        error = await self._link.control()
        if error is None:
            path = self._config.path(what.path)
            reply = await self._link.send("execute", path, _body(what, state.action)).result()
            if reply["status"] == "completed":
                state.result = _words(reply.get("body"))
                return None
            error = reply["error"]
        return error

    def why_not_at_node(self, action: Action) -> str | None:
        """Tell why an action of a node cannot be done; None: it can."""
        own = action.action_type in self._own and action.action_type not in self._config.actions
        return None if own else self.why_not(action)

    def why_not(self, action: Action | ZoneAction) -> str | None:
        """Tell why an action cannot be done; None: it can."""
        what = self._config.actions.get(action.action_type)
        if what is None:
            there = ", ".join(sorted(self._config.actions)) or "none"
            return f"there is no action {action.action_type}; there are: {there}"
        unknown = [p.key for p in action.action_parameters if p.key not in what.parameters]
        if unknown:
            return f"{action.action_type} has no parameter {', '.join(unknown)}"
        return None


def _body(what: ActionConfig, action: Action) -> dict[str, Any] | None:
    given = {parameter.key: parameter.value for parameter in action.action_parameters}
    return what.body if not given else {**(what.body or {}), **given}


def _words(body: Any) -> str:
    return "" if body is None else str(body)[:500]
