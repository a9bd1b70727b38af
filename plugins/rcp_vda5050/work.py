"""Carries out an order: drives from node to node, and does what has to be done there.

Blocking types (2.1 section 6.10.2): NONE goes on while others run and while driving, SOFT while others
run, SINGLE (3.0) while driving, HARD alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, Literal

import structlog
from msgspec import Struct

from rcp_vda5050.config import ActionConfig, RobotConfig
from rcp_vda5050.faults import Fault, OrderRefused
from rcp_vda5050.link import Link, NotStoppedError, Running
from rcp_vda5050.messages import Action, Order
from rcp_vda5050.orders import Leg, OrderBook

__all__ = ["ActionState", "Work"]

log = structlog.get_logger("rcp.vda5050")
_MOST = 10  # refusals that are shown
_ENDED = ("FINISHED", "FAILED")
_STOPS_DRIVING = ("SOFT", "HARD")
_ALONE = ("SINGLE", "HARD")
_HELD = frozenset({
    "estop_active", "lease_held", "lease_lost", "lease_required", "unauthenticated", "cancelled",
    "adapter_unavailable", "mode_forbids", "fenced",
})  # fmt: skip
"""Errors after which the order is paused, and goes on when the fleet manager says so (`stopPause`)."""
_STOPPED = frozenset({"estop_active", "lease_lost", "cancelled", "fenced"})
"""Those of an action that somebody stopped: the order is paused if something of it is left."""
_GO_ON = "Send stopPause to go on, or cancelOrder."


class ActionState(Struct):
    """How far an action has come."""

    action: Action
    status: Literal["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "FINISHED", "FAILED"]
    result: str = ""


class Work:
    """The order of one robot, and its actions; `changed` is called with each change."""

    def __init__(self, config: RobotConfig, link: Link, changed: Callable[[], None]) -> None:
        self._config, self._link, self._changed = config, link, changed
        self.book = OrderBook(config.map, config.start_range, self._why_not)
        self.states: dict[str, ActionState] = {}
        self.instant: dict[str, ActionState] = {}
        self.refusals: list[Fault] = []
        self.halted: Fault | None = None
        """Why the order does not go on."""
        self._resumed = asyncio.Event()
        self._resumed.set()
        self._drive: Running | None = None
        self._carrying: asyncio.Task[None] | None = None
        """Carries out the base that there is."""
        self._doing: set[asyncio.Task[None]] = set()
        """Actions of the order that run."""
        self._instants = 0
        """Instant actions that run."""
        self._cancelling = False

    @property
    def paused(self) -> bool:
        """Whether the order waits for `resume`."""
        return not self._resumed.is_set()

    @property
    def driving(self) -> bool:
        """Whether the robot is on its way."""
        return self._drive is not None

    @property
    def busy(self) -> bool:
        """Whether something of an order is left."""
        return bool(self.book.legs or self._doing or self._carries or self._cancelling)

    @property
    def _carries(self) -> bool:
        return self._carrying is not None and not self._carrying.done()

    async def close(self) -> list[str]:
        """Cancel what runs, and see it end; return why something is not known to have stopped."""
        return await self._end(
            [task for task in (self._carrying, *self._doing) if task is not None]
        )

    @staticmethod
    async def _end(tasks: Sequence[asyncio.Task[None]]) -> list[str]:
        """Cancel tasks, and see them end; return why what they did is not known to have stopped."""
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
        return [str(each) for each in ended if isinstance(each, NotStoppedError)]

    # From the fleet manager

    def order(self, order: Order, here: tuple[float, float] | None) -> None:
        """Take an order or an update of it."""
        fresh = order.order_id != self.book.order_id
        known = frozenset[str]() if fresh else frozenset(self.states)
        try:
            actions = self.book.take(order, here, busy=self.busy, known=known)
        except OrderRefused as refused:
            self.refuse(refused.fault)
            return
        if actions is None:
            return
        self.refusals.clear()
        if fresh:
            self.states.clear()
        self.states |= {a.action_id: ActionState(a, "WAITING") for a in actions}
        self._begin()
        self._changed()

    def refuse(self, fault: Fault) -> None:
        """Show a refusal until an order is accepted."""
        if fault not in self.refusals:
            self.refusals = [*self.refusals[1 - _MOST :], fault]
        self._changed()

    def pause(self, fault: Fault | None = None) -> None:
        """Stop driving and begin nothing, until told to go on."""
        if fault is not None:
            self.halted = fault
        self._resumed.clear()
        if self._drive is not None:
            self._drive.cancel()
        self._changed()

    def resume(self) -> None:
        """Go on."""
        self.halted = None
        self._resumed.set()
        self._begin()
        self._changed()

    async def cancel(self) -> bool:
        """Cancel the order, and wait until nothing of it runs; return whether there was one.

        :raises NotStoppedError: the robot does not confirm that it has stopped.
        """
        if self._cancelling:
            return False
        if not self.busy:
            if self.halted is not None:  # a pause that outlasted its order
                self.resume()
            return False
        self._cancelling = True
        try:
            self.book.cancel()
            running = await self.close()  # before it may go on: nothing of it drives any more
        finally:
            self._cancelling = False
        for state in self.states.values():
            if state.status not in _ENDED:
                state.status = "FAILED"
        self.halted = None
        self._resumed.set()
        await self._settle()
        self._changed()
        if running:
            raise NotStoppedError("; ".join(running))
        return True

    # Doing it

    def _begin(self) -> None:
        if not self._carries and self.book.next is not None:
            self._carrying = asyncio.get_running_loop().create_task(self._carry_out())
            self._carrying.add_done_callback(self._carried)

    def _carried(self, task: asyncio.Task[None]) -> None:
        if task.cancelled() or isinstance(error := task.exception(), NotStoppedError):
            return  # `cancel` tells of it
        if error is not None:
            log.error("order_failed", robot=self._config.robot, exc_info=error)
            self.pause(Fault("unavailable", "the gateway could not go on with the order"))

    async def _carry_out(self) -> None:
        while (leg := self.book.next) is not None:
            if leg.edge is not None:
                await self._actions(leg.edge.actions)
                await self._reach(leg)
            node = self.book.reached()
            self._changed()
            await self._actions(node.actions)
            await self._settle()

    async def _settle(self) -> None:
        """Give control back if nothing needs it; what is being carried out is not counted."""
        if not (self.book.legs or self._doing or self._instants or self._cancelling):
            await self._link.release()

    async def _reach(self, leg: Leg) -> None:
        """Drive to a node; pauses come in between."""
        goal = self._goal(leg)
        while True:
            await self._resumed.wait()
            error = await self._link.control()
            if self.paused:  # meanwhile
                continue
            if error is None:
                drive = self._drive = self._send("action/move_to", goal)
                self._changed()
                try:
                    reply = await drive.result()
                finally:
                    self._drive = None
                    self._changed()
                if reply["status"] == "completed":
                    return
                if drive.cancelled:  # by a pause
                    continue
                error = reply["error"]
            self._hold(leg, error)

    def _goal(self, leg: Leg) -> dict[str, Any]:
        position = leg.node.node_position
        assert position is not None  # refused otherwise
        goal: dict[str, Any] = {
            "position": {"x": position.x, "y": position.y},
            "frame": self._config.frame,
        }
        if position.theta is not None:
            goal["yaw"] = position.theta
        if (tolerance := position.tolerance or self._config.tolerance) is not None:
            goal["tolerance"] = tolerance
        if leg.edge is not None and leg.edge.speed is not None:
            goal["speed"] = leg.edge.speed
        return goal

    def _hold(self, leg: Leg, error: dict[str, Any]) -> None:
        """Pause because the robot does not get to a node."""
        held = error["code"] in _HELD
        text = f"on the way to {leg.node.node_id}: {error['message']}"
        references = (("orderId", self.book.order_id), ("nodeId", leg.node.node_id))
        hint = _GO_ON if held else error.get("remedy", "")
        self.pause(Fault("unavailable" if held else "drive", text, references, hint))

    def _send(self, path: str, body: Any) -> Running:
        return self._link.send("execute", self._config.path(path), body)

    async def _actions(self, actions: Sequence[Action]) -> None:
        """Do the actions of a node or an edge; return when the robot may drive on."""
        waits = False
        for action in actions:
            if action.blocking_type in _ALONE:
                await self._all_done()
            await self._resumed.wait()
            state = self.states.get(action.action_id)
            if state is None or state.status != "WAITING":
                continue
            task = asyncio.get_running_loop().create_task(self._do(state))
            self._doing.add(task)
            task.add_done_callback(self._did)
            if action.blocking_type in _ALONE:
                await self._all_done()
            waits = waits or action.blocking_type in _STOPS_DRIVING
        if waits:
            await self._all_done()

    async def _all_done(self) -> None:
        while self._doing:
            await asyncio.wait(self._doing)

    def _did(self, task: asyncio.Task[None]) -> None:
        self._doing.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("action_failed", robot=self._config.robot, exc_info=error)
        self._changed()

    async def _do(self, state: ActionState) -> None:
        """Do an action; ended when the robot says so, also by a cancel."""
        what = self._config.actions[state.action.action_type]
        state.status = "RUNNING"
        try:
            error = await self._link.control()
            if error is None:
                reply = await self._send(what.path, _body(what, state.action)).result()
                if reply["status"] == "completed":
                    state.status, state.result = "FINISHED", _words(reply.get("body"))
                    return
                error = reply["error"]
            state.result = error["message"]
            references = (("actionId", state.action.action_id), ("orderId", self.book.order_id))
            text = f"{state.action.action_type}: {error['message']}"
            self.refuse(Fault("work", text, references, error.get("remedy", "")))
            if error["code"] in _STOPPED and self._is_left(state):
                # Before the next action begins: that an e-stop is the reason is told later.
                self.pause(Fault("unavailable", text, references, _GO_ON))
        finally:
            if state.status == "RUNNING":
                state.status = "FAILED"
            self._changed()

    def _is_left(self, stopped: ActionState) -> bool:
        """Tell whether an action is one of the order, and something follows it."""
        waiting = any(state.status == "WAITING" for state in self.states.values())
        return stopped.action.action_id in self.states and (waiting or bool(self.book.legs))

    async def do_now(self, state: ActionState) -> None:
        """Do an instant action that is none of the standard's own."""
        action = state.action
        if (reason := self._why_not(action)) is not None:
            state.status, state.result = "FAILED", reason
            self.refuse(Fault("instant_action", reason, (("actionId", action.action_id),)))
            return
        self._instants += 1
        try:
            await self._do(state)
        finally:
            self._instants -= 1
        if not self._carries:
            await self._settle()

    def _why_not(self, action: Action) -> str | None:
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
