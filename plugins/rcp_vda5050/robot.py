"""One robot as a fleet manager sees it: takes its messages, and says what there is to say."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import msgspec
import structlog

from rcp_gateway.api import PluginStore
from rcp_gateway.client_api import ClientApi
from rcp_protocol.timeouts import timeout
from rcp_vda5050.config import RobotConfig
from rcp_vda5050.factsheet import factsheet, own_actions
from rcp_vda5050.faults import Fault
from rcp_vda5050.link import Link, NotStoppedError
from rcp_vda5050.messages import Action, Addressed, InstantActions, Order
from rcp_vda5050.performer import ENDED, ActionState, Own
from rcp_vda5050.states import Headers, Senses, connection, state, visualization
from rcp_vda5050.work import Work
from rcp_vda5050.zone_intake import Fetch, ZoneIntake
from rcp_vda5050.zone_messages import Responses, ZoneSetMessage
from rcp_vda5050.zone_store import ZoneStore

__all__ = ["LARGEST", "Robot"]

log = structlog.get_logger("rcp.vda5050")
_EVERY = 30.0  # s between two states, at most (section 6.10)
_GATHER = 0.05  # s in which changes become one state
_MOST = 200  # instant actions that are remembered
_AT_ONCE = 20  # instant actions that run
_ALWAYS = ("startPause", "stopPause", "cancelOrder")
"""Instant actions that are neither counted nor refused by that limit: whoever stops a robot waits for nothing."""
LARGEST = 1 << 20
"""Bytes of a message, at most."""
_STOPPING = ("startPause", "cancelOrder")
"""Instant actions that are carried out although the broker has kept them: they only stop."""
_LOOK_AGAIN, _RARELY = (
    1.0,
    10.0,
)  # s until a look at the e-stop that failed is repeated, at first and at last
_ESTOP, _ROBOTS = "/system/estop", "/system/robots"
T = TypeVar("T", bound=Addressed)
Publish = Callable[[str, dict[str, Any]], None]


class Robot:
    """One robot; `publish` sends the body of a topic, or drops it while there is no broker."""

    def __init__(
        self,
        config: RobotConfig,
        client_api: ClientApi,
        rate: float,
        publish: Publish,
        store: PluginStore,
        fetch: Fetch | None,
    ) -> None:
        self._config, self._publish, self._rate = config, publish, rate
        self._headers = Headers(config)
        self._senses = Senses()
        self._handlers: dict[str, Callable[[Any], None]] = {
            config.path("sensor/pose"): self._senses.pose,
            config.path("sensor/velocity"): self._senses.velocity,
            config.path("sensor/battery"): self._senses.battery,
            _ESTOP: self._estop,
        }
        self._link = Link(config, client_api, tuple(self._handlers), self._sensed)
        own: Own = {"enableMap": self._enable_map}
        if config.version == "3.0":
            own = {**own, "enableZoneSet": self._enable_zone_set}
        self.work = Work(config, self._link, own, self.changed)
        zones = ZoneStore(store, config, self.changed)
        self._intake = ZoneIntake(config.map, self.work, zones, fetch, self.changed)
        self._due = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._looks = 0

    async def open(self, rows: Mapping[str, Any]) -> None:
        """Begin to work, with the zones that earlier runs have stored."""
        if self._config.version == "3.0":  # with another, nobody could end them
            await self._intake.restore(rows)
        self._link.open()
        for work in (self._say_state(), self._say_where()):
            self._start(work)

    async def close(self) -> None:
        """End what runs, and give control back."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.work.close()
        self.work.zones.releases.close()
        await self._link.close()

    def _start(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("task_failed", robot=self._config.robot, exc_info=error)

    def written(self, topic: str, body: dict[str, Any]) -> bytes:
        """Return the payload of a topic."""
        return msgspec.json.encode(self._headers.header(topic) | body)

    def connection(self, how: str) -> bytes:
        """Return the payload of `connection`."""
        return self.written("connection", connection(how))

    def greet(self) -> None:
        """Tell everything: the broker has just been reached."""
        self._publish("factsheet", factsheet(self._config))
        self._say()

    def changed(self) -> None:
        """Say the new state soon."""
        self._due.set()

    # From the fleet manager

    def take(self, topic: str, payload: bytes) -> None:
        """Take a message; a wrong one is told in the state."""
        match topic:
            case "order":
                if (order := self._decoded(payload, Order)) is not None:
                    self.work.order(order, self._senses.here)
            case "zoneSet":
                if (message := self._decoded(payload, ZoneSetMessage)) is not None:
                    self._start(self._intake.take(message.zone_set))
            case "responses":
                if (answers := self._decoded(payload, Responses)) is not None:
                    self._answered(answers)
            case _:
                if (given := self._decoded(payload, InstantActions)) is not None:
                    for action in given.actions:
                        self._take_instant(action)

    def take_kept(self, topic: str, payload: bytes) -> None:
        """Refuse a message that the broker kept for whoever comes: nobody knows how old it is.

        Only what stops the robot is carried out: it may have been sent while the robot was not reached.
        """
        text = f"{topic}: the message was kept by the broker, so that it is not carried out"
        if topic == "instantActions":
            if (given := self._decoded(payload, InstantActions)) is None:
                return
            stopping = [each for each in given.actions if each.action_type in _STOPPING]
            for action in stopping:
                self._take_instant(action)
            if stopping:
                done = ", ".join(dict.fromkeys(each.action_type for each in stopping))
                text = f"{topic}: the message was kept by the broker, so that only {done} of it is carried out"
        hint = "Publish it without the flag `retain`, and clear the one that is kept."
        self.work.refuse(Fault("malformed", text, (("topic", topic),), hint))

    def refuse_large(self, topic: str, size: int) -> None:
        """Refuse a message by its size."""
        text = f"{topic}: {size} bytes are too many: a message has at most {LARGEST}"
        self.work.refuse(Fault("malformed", text, (("topic", topic),)))

    def refuse_dropped(self, topic: str) -> None:
        """Tell that messages were dropped, because too many waited."""
        text = f"{topic}: messages came faster than they are taken, and some were dropped"
        hint = "Send what the state does not show again, and fewer messages at once."
        self.work.refuse(Fault("malformed", text, (("topic", topic),), hint))

    def _answered(self, answers: Responses) -> None:
        for each in answers.responses:
            reason = self.work.zones.releases.answer(each)
            if reason is not None:
                references = (("requestId", each.request_id),)
                self.work.refuse(Fault("malformed", f"responses: {reason}", references))

    def _take_instant(self, action: Action) -> None:
        """Begin an instant action; one that came already is not done again."""
        instant, id_ = self.work.instant, action.action_id
        if id_ in instant:
            return
        ended = [key for key, each in instant.items() if each.status in ENDED]
        running = [
            each
            for key, each in instant.items()
            if key not in ended and each.action.action_type not in _ALWAYS
        ]
        reason = None
        if id_ in self.work.states:
            reason = f"an action of the order has the id {id_}"
        elif len(running) >= _AT_ONCE and action.action_type not in _ALWAYS:
            reason = f"{len(running)} instant actions run already"
        if reason is not None:
            self.work.refuse(Fault("instant_action", reason, (("actionId", id_),)))
            return
        for key in ended[: max(0, len(instant) + 1 - _MOST)]:
            del instant[key]
        state = instant[id_] = ActionState(action, "WAITING")
        self._start(self._act(state))

    def _decoded(self, payload: bytes, type_: type[T]) -> T | None:
        try:
            if len(payload) > LARGEST:
                raise msgspec.ValidationError(f"{len(payload)} bytes are too many")
            message = msgspec.json.decode(payload, type=type_)
        except (msgspec.MsgspecError, RecursionError) as error:
            references = _references(payload)
            self.work.refuse(Fault("malformed", f"{type_.__name__}: {error}", references))
            return None
        if (message.manufacturer, message.serial_number) != (
            self._config.manufacturer,
            self._config.serial,
        ):
            text = f"the message is for {message.manufacturer[:64]} {message.serial_number[:64]}"
            self.work.refuse(Fault("malformed", text))
            return None
        if message.version.partition(".")[0] != self._config.version[0]:
            text = f"version {message.version[:64]} is not {self._config.version}"
            self.work.refuse(Fault("malformed", text))
            return None
        return message

    async def _act(self, mark: ActionState) -> None:
        action = mark.action
        if action.action_type not in own_actions(self._config):
            await self.work.do_now(mark)
            self.changed()
            return
        mark.status = "RUNNING"
        reason: str | Fault | None = None
        match action.action_type:
            case "startPause":
                self.work.pause()
            case "stopPause":
                self.work.resume()
            case "cancelOrder":
                await self._cancel(mark)
            case "factsheetRequest":
                self._publish("factsheet", factsheet(self._config))
            case "enableMap":
                reason = await self._enable_map(action)
            case "enableZoneSet":
                reason = await self._enable_zone_set(action)
            case "downloadZoneSet":
                reason = await self._intake.download(action)
            case "deleteZoneSet":
                reason = await self._intake.delete(action.parameter("zoneSetId"))
            case "clearZoneActions":
                self.work.zone_actions.clear()
            case "clearInstantActions":
                instant = self.work.instant
                for id_ in [id_ for id_, each in instant.items() if each.status in ENDED]:
                    del instant[id_]
            case _:
                pass
        if reason is not None:
            fault = reason
            if isinstance(fault, str):
                fault = Fault("instant_action", fault, (("actionId", action.action_id),))
            mark.status, mark.result = "FAILED", fault.text
            self.work.refuse(fault)
        if mark.status == "RUNNING":
            mark.status = "FINISHED"
        self.changed()

    async def _enable_zone_set(self, action: Action) -> str | None:
        """Put a zone set in force; return why not."""
        return await self._intake.enable(action.parameter("zoneSetId"))

    async def _enable_map(self, action: Action) -> str | None:
        """Tell why a map cannot be enabled; the configured one is."""
        asked = (action.parameter("mapId"), action.parameter("mapVersion"))
        there = (self._config.map, self._config.map_version)
        return None if asked == there else f"there is no map {asked[0]} of version {asked[1]}"

    async def _cancel(self, mark: ActionState) -> None:
        """Cancel the order; finished only if the robot confirms that nothing of it runs."""
        references = (("actionId", mark.action.action_id),)
        meant, order_id = mark.action.parameter("orderId"), self.work.book.order_id
        try:
            fault = Fault("no_order", "there is no order", references)
            if meant not in (None, order_id):
                fault = Fault("no_order", f"the order is {order_id}, not {meant}", references)
            elif await self.work.cancel():
                return
        except NotStoppedError as error:
            hint = "Look at the robot; an e-stop at the gateway stops it."
            fault = Fault("unavailable", f"the cancel is not confirmed: {error}", references, hint)
        mark.status = "FAILED"
        self.work.refuse(fault)

    # From the gateway

    def _sensed(self, path: str, value: Any) -> None:
        before = self._senses.here
        try:
            self._handlers[path](value)
        except (AttributeError, KeyError, TypeError, ValueError):  # of another type: as if unknown
            self._handlers[path](None)
        self.work.zones.moved(self._senses.here)
        if (before is None) != (self._senses.here is None):
            self.changed()

    def _estop(self, _: Any) -> None:
        """Look whether the robot is stopped: the e-stop names backends, the inventory robots."""
        self._start(self._look())

    async def _look(self) -> None:
        self._looks += 1
        look, pause = self._looks, _LOOK_AGAIN
        while True:
            reply = await self._link.send("read", _ROBOTS, None).result()
            if look != self._looks:  # a later one has begun, or has ended
                return
            if reply["status"] == "completed":
                break
            await asyncio.sleep(pause)
            if look != self._looks:
                return
            pause = min(2 * pause, _RARELY)
        listed: list[dict[str, Any]] = reply.get("body") or []
        scope = self._config.robot
        stopped = any(
            each.get("estop", False)
            for each in listed
            if each["path"] == scope or each["path"].startswith(f"{scope}/")
        )
        if stopped and not self._senses.stopped and self.work.busy:
            hint = "Reset it, then send stopPause or cancelOrder."
            self.work.pause(Fault("unavailable", "an e-stop is latched", (), hint))
        self._senses.stopped = stopped
        self.changed()

    # To the fleet manager

    async def _say_state(self) -> None:
        while True:
            try:
                async with timeout(_EVERY):
                    await self._due.wait()
            except TimeoutError:
                pass
            else:
                await asyncio.sleep(_GATHER)
            self._due.clear()
            try:
                self._say()
            except Exception:
                log.exception("state_failed", robot=self._config.robot)

    def _say(self) -> None:
        faults = [*self.work.faults, *self._intake.faults()]
        self._publish("state", state(self._config, self._senses, self.work, faults))

    async def _say_where(self) -> None:
        while True:
            await asyncio.sleep(1 / self._rate)
            body = visualization(self._config, self._senses)
            if body:
                self._publish("visualization", body)


def _references(payload: bytes) -> tuple[tuple[str, str], ...]:
    """Return which order a message is about, if it says so."""
    try:
        found: Any = msgspec.json.decode(payload[:LARGEST])
    except (msgspec.MsgspecError, RecursionError):
        return ()
    if not isinstance(found, dict):
        return ()
    return tuple(
        (name, str(found[name])[:256])
        for name in ("headerId", "orderId", "orderUpdateId")
        if name in found
    )
