"""Carries out an order: drives from node to node, and does what has to be done there."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from typing import Any

import structlog

from rcp_geometry import Corner
from rcp_vda5050.config import RobotConfig
from rcp_vda5050.faults import Fault, OrderRefused
from rcp_vda5050.link import Link, NotStoppedError, Running
from rcp_vda5050.messages import Action, Order
from rcp_vda5050.orders import Leg, OrderBook
from rcp_vda5050.performer import ENDED, ActionState, Own, Performer
from rcp_vda5050.zone_actions import ZoneActions
from rcp_vda5050.zone_messages import Zone
from rcp_vda5050.zones import Zones

__all__ = ["Work"]

log = structlog.get_logger("rcp.vda5050")
_MOST = 10  # refusals that are shown
_HELD = frozenset({
    "estop_active", "lease_held", "lease_lost", "lease_required", "unauthenticated", "cancelled",
    "adapter_unavailable", "mode_forbids", "fenced",
})  # fmt: skip
"""Errors after which the order is paused, and goes on when the fleet manager says so (`stopPause`)."""
_STOPPED = frozenset({"estop_active", "lease_lost", "cancelled", "fenced"})
"""Those of an action that somebody stopped: the order is paused if something of it is left."""
_SWITCHES = frozenset({"enableMap", "enableZoneSet"})
"""Those without which the rest of the order would be driven by another map or other zones than it was made for."""
_GO_ON = "Send stopPause to go on, or cancelOrder."


class Work:
    """The order of one robot, and its actions; `changed` is called with each change."""

    def __init__(
        self, config: RobotConfig, link: Link, own: Own, changed: Callable[[], None]
    ) -> None:
        self._config, self._link, self._changed = config, link, changed
        self._resumed = asyncio.Event()
        self._resumed.set()
        self.performer = Performer(config, link, own, self._resumed, changed, self._failed)
        self.zones = Zones(config.radius, self, changed)
        self.zone_actions = ZoneActions(self.performer, self._zone_actions_done)
        self.book = OrderBook(
            config.map,
            config.start_range,
            self.performer.why_not,
            self.zones.blocking,
            self.performer.why_not_at_node,
        )
        self.states: dict[str, ActionState] = {}
        self.instant: dict[str, ActionState] = {}
        self.refusals: list[Fault] = []
        self.halted: Fault | None = None
        """Why the order does not go on."""
        self._drive: Running | None = None
        self._carrying: asyncio.Task[None] | None = None
        """Carries out the base that there is."""
        self._instants = 0
        """Instant actions that run."""
        self._cancelling = False
        self._settling: asyncio.Task[None] | None = None

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
        doing = (*self.performer.awaited, *self.zone_actions.tasks)
        return bool(self.book.legs or doing or self._carries or self._cancelling)

    @property
    def _doing(self) -> list[asyncio.Task[None]]:
        """Actions of the order and of zones that run, or wait for others."""
        return [*self.performer.running, *self.zone_actions.tasks]

    @property
    def faults(self) -> list[Fault]:
        """What is wrong now."""
        halted = [self.halted] if self.halted is not None else []
        return [*self.refusals, *halted, *self.zones.faults()]

    @property
    def _carries(self) -> bool:
        return self._carrying is not None and not self._carrying.done()

    async def close(self) -> list[str]:
        """Cancel what runs, and see it end; return why something is not known to have stopped."""
        return await self._end(
            [task for task in (self._carrying, self._settling, *self._doing) if task is not None]
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
        named = (("orderId", order.order_id), ("orderUpdateId", str(order.order_update_id)))
        if (fault := self.zones.sets.fault(*named)) is not None:
            self.refuse(fault)
            return
        fresh = order.order_id != self.book.order_id
        known = frozenset[str]() if fresh else frozenset(self.states)
        try:
            actions = self.book.take(order, here, busy=self.busy, known=known)
        except OrderRefused as refused:
            self.refuse(refused.fault)
            return
        if actions is None:
            if self._config.version == "3.0":
                self.refuse(Fault("same_update", "this update was accepted already", named))
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
        held = self.halted is not None and self.halted.kind == "not_enabled"
        if fault is not None and not held:  # whatever else stops it, its zones are still not known
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
        self.zone_actions.stop()
        for state in self.states.values():
            if state.status not in ENDED:
                state.status = "FAILED"
        self.halted = None
        self._resumed.set()
        await self._settle()
        self._changed()
        if running:
            raise NotStoppedError("; ".join(running))
        return True

    # From zones

    def reconsider(self) -> None:
        """Stop a drive that is under way; it begins anew as soon as zones admit it."""
        if self._drive is not None:
            self._drive.cancel()

    def zone_entered(self, zone: Zone) -> None:
        """Perform the actions of a zone, if it was entered on the way of an order."""
        if self.driving:
            self.zone_actions.enter(zone)
            if self.zone_actions.blocks:
                self.reconsider()

    def zone_left(self, zone: Zone) -> None:
        """Perform those that follow it."""
        self.zone_actions.leave(zone)
        if self.zone_actions.blocks:
            self.reconsider()

    def _zone_actions_done(self) -> None:
        self._changed()
        if not self._carries:
            self._settling = asyncio.get_running_loop().create_task(self._settle())

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
                await self.performer.perform(self._states_of(leg.edge.actions))
                await self._reach(leg)
            node = self.book.reached()
            self._changed()
            await self.performer.perform(self._states_of(node.actions))
            await self._settle()

    async def _settle(self) -> None:
        """Give control back if nothing needs it; what is being carried out is not counted."""
        if not (self.book.legs or self._doing or self._instants or self._cancelling):
            await self._link.release()

    async def _reach(self, leg: Leg) -> None:
        """Drive to a node; pauses come in between, and zones that are not to be entered yet."""
        assert leg.node.node_position is not None  # refused otherwise
        place = leg.node.node_position.point
        try:
            while True:
                await self._resumed.wait()
                self.zones.stands()
                if (fault := await self._admitted(place)) is not None:
                    self._hold_at(leg, fault)
                    continue
                error = await self._link.control()
                if self.paused or not self._admits(place):  # meanwhile
                    continue
                if error is None:
                    reply = await self._driven(leg)
                    if reply is None:  # stopped from here
                        continue
                    if reply["status"] == "completed":
                        break
                    error = reply["error"]
                self._hold(leg, error)
        except NotStoppedError:
            raise  # it may still drive: what it holds stays reserved
        except asyncio.CancelledError:
            self.zones.arrived()
            raise
        self.zones.arrived()

    async def _admitted(self, place: Corner) -> Fault | None:
        """Wait until actions of zones have ended and zones admit a drive; return what stands against it."""
        while self.zone_actions.blocks and (doing := self.zone_actions.tasks):
            await asyncio.wait(doing)
        return await self.zones.admit(place)

    def _admits(self, place: Corner) -> bool:
        return not self.zone_actions.blocks and self.zones.admits(place)

    async def _driven(self, leg: Leg) -> dict[str, Any] | None:
        """Drive, and return the last reply; None: it was stopped from here, and confirmed that."""
        drive = self._drive = self._send("action/move_to", self._goal(leg))
        self._changed()
        try:
            reply = await drive.result()
        except NotStoppedError:
            raise  # it may still drive: that a grant was lost is not told
        except asyncio.CancelledError:
            self.zones.stands()
            raise
        finally:
            self._drive = None
            self._changed()
        failed = reply["status"] == "failed" and reply["error"]["code"] not in _STOPPED
        if drive.cancelled and failed:
            return reply  # it may still drive: a lost grant is told when somebody goes on
        self.zones.stands()
        return None if drive.cancelled and reply["status"] != "completed" else reply

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
        speed = min(self.zones.pace(position.point), (leg.edge and leg.edge.speed) or math.inf)
        if speed < math.inf:
            goal["speed"] = speed
        return goal

    def _hold_at(self, leg: Leg, fault: Fault) -> None:
        """Pause because a zone stands against the way to a node."""
        named = (("orderId", self.book.order_id), ("nodeId", leg.node.node_id))
        text = f"on the way to {leg.node.node_id}: {fault.text}"
        self.pause(Fault(fault.kind, text, (*named, *fault.references), fault.hint or _GO_ON))

    def _hold(self, leg: Leg, error: dict[str, Any]) -> None:
        """Pause because the robot does not get to a node."""
        held = error["code"] in _HELD
        text = f"on the way to {leg.node.node_id}: {error['message']}"
        references = (("orderId", self.book.order_id), ("nodeId", leg.node.node_id))
        hint = _GO_ON if held else error.get("remedy", "")
        self.pause(Fault("unavailable" if held else "drive", text, references, hint))

    def _send(self, path: str, body: Any) -> Running:
        return self._link.send("execute", self._config.path(path), body)

    def _states_of(self, actions: Sequence[Action]) -> list[ActionState]:
        return [each for a in actions if (each := self.states.get(a.action_id)) is not None]

    def _failed(self, state: ActionState, error: dict[str, Any]) -> None:
        """Tell of an action that did not finish, and pause what must not follow it."""
        references = (("actionId", state.action.action_id), ("orderId", self.book.order_id))
        text = f"{state.action.action_type}: {error['message']}"
        self.refuse(Fault("work", text, references, error.get("remedy", "")))
        of_order = self.states.get(state.action.action_id) is state
        if of_order and state.action.action_type in _SWITCHES:
            # Also if nothing is left of the order: an update or a new one may come.
            hint = f"Send {state.action.action_type} as an instant action and then stopPause, or cancelOrder."
            self.pause(Fault("not_enabled", text, references, hint))
        elif error["code"] in _STOPPED and self._is_left(state):
            # Before the next action begins: that an e-stop is the reason is told later.
            self.pause(Fault("unavailable", text, references, _GO_ON))

    def _is_left(self, stopped: ActionState) -> bool:
        """Tell whether an action is one of the order, and something follows it."""
        waiting = any(state.status == "WAITING" for state in self.states.values())
        return stopped.action.action_id in self.states and (waiting or bool(self.book.legs))

    async def do_now(self, state: ActionState) -> None:
        """Do an instant action that is none of the standard's own."""
        action = state.action
        if (reason := self.performer.why_not(action)) is not None:
            state.status, state.result = "FAILED", reason
            self.refuse(Fault("instant_action", reason, (("actionId", action.action_id),)))
            return
        self._instants += 1
        try:
            await self.performer.do(state)
        finally:
            self._instants -= 1
        if not self._carries:
            await self._settle()
