"""The zones in force for one robot: where it is, what it may drive, and what happens at their borders.

VDA 5050 3.0 section 6.4. A zone counts as touched by the circle around the robot that its length and
width in the factsheet span. Where the robot plans its own way, the straight one is taken for it before it
drives, and its position while it drives.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from typing import Protocol

from rcp_geometry import Corner
from rcp_vda5050.faults import Fault, FaultKind
from rcp_vda5050.releases import Releases, Request
from rcp_vda5050.zone_messages import Zone
from rcp_vda5050.zone_sets import Area, ZoneSets

__all__ = ["Driver", "Zones"]


class Driver(Protocol):
    """What zones ask of whoever carries out the order."""

    @property
    def driving(self) -> bool:
        """Whether the robot is on its way."""
        ...

    def reconsider(self) -> None:
        """Stop a drive that is under way, and begin it anew if zones admit it."""
        ...

    def pause(self, fault: Fault | None = None) -> None:
        """Stop the order."""
        ...

    def zone_entered(self, zone: Zone) -> None:
        """Perform the actions of a zone."""
        ...

    def zone_left(self, zone: Zone) -> None:
        """Perform those that follow it."""
        ...


class Zones:
    """The zones of one robot; `changed` is called with each change of the state."""

    def __init__(self, radius: float, driver: Driver, changed: Callable[[], None]) -> None:
        self._radius, self._driver, self._changed = radius, driver, changed
        self.sets = ZoneSets()
        self.releases = Releases(self._lost, self._heard)
        self._news = asyncio.Event()
        self._here: Corner | None = None
        self._inside: dict[str, Area] = {}
        self._checked: Corner | None = None
        self._free = 0.0
        """How far it may move from there before it can touch or leave a zone."""
        self._goal: Corner | None = None
        self._pace = math.inf
        self._entered_unasked: set[str] = set()

    # Zone sets

    def enable(self, id_: str) -> str | None:
        """Put a zone set in force; return why not."""
        before = self.sets.enabled
        why = self.sets.enable(id_)
        if why is None and self.sets.enabled is not before:
            for area in self._inside.values():
                self._driver.zone_left(area.zone)
            self._inside, self._checked = {}, None
            self._entered_unasked.clear()
            self.releases.retire()
            if self._driver.driving:
                self._driver.reconsider()
            else:
                self.releases.settle()
            self._look()
            self._heard()
        return why

    @property
    def _areas(self) -> tuple[Area, ...]:
        return self.sets.enabled.areas if self.sets.enabled is not None else ()

    def _on_way(self, start: Corner, end: Corner, kind: str) -> Iterable[Area]:
        return (
            each
            for each in self._areas
            if each.zone.zone_type == kind and each.near(start, end, self._radius)
        )

    def blocking(self, start: Corner, end: Corner) -> str | None:
        """Return the BLOCKED zone that a straight way touches."""
        return next((each.zone.zone_id for each in self._on_way(start, end, "BLOCKED")), None)

    # Driving

    async def admit(self, goal: Corner) -> Fault | None:
        """Wait until the robot may drive to a place; return what is in its way until somebody decides."""
        self._goal = goal
        self.releases.rejected.clear()
        while True:
            self._news.clear()
            fault = self._obstacle(goal)
            if fault is not None or self.admits(goal):
                return fault
            assert self.sets.enabled is not None
            needed = self._needed(goal)
            self.releases.keep({*needed, *self._held()})
            self.releases.want(self.sets.enabled.id, needed)
            self._mark_entered()
            self._changed()
            await self._news.wait()

    def admits(self, goal: Corner) -> bool:
        """Tell whether the robot may drive to a place now."""
        return self._obstacle(goal) is None and all(
            self._may_be_in(each) for each in self._needed(goal).values()
        )

    def pace(self, goal: Corner) -> float:
        """Return the lowest speed limit on the way to a place, m/s, and remember it for the drive."""
        limits = self._on_way(self._here or goal, goal, "SPEED_LIMIT")
        self._pace = min((each.zone.maximum_speed or math.inf for each in limits), default=math.inf)
        return self._pace

    def stands(self) -> None:
        """Note that a drive has ended."""
        self.releases.settle()
        self._changed()

    def arrived(self) -> None:
        """Note that nothing is to be driven now: only zones that the robot is in need a release."""
        self._goal = None
        self.releases.keep(self._held())
        self._changed()

    def _obstacle(self, goal: Corner) -> Fault | None:
        if not self._areas:
            return None
        if self._here is None:
            return Fault("lost", "the position of the robot is not known, and zones are in force")
        blocked = self.blocking(self._here, goal)
        if blocked is not None:
            return _fault("drive", f"zone {blocked} is BLOCKED, and on the way", blocked)
        rejected = next(
            (each for each in self._needed(goal) if each in self.releases.rejected), None
        )
        if rejected is not None:
            text = f"the release of zone {rejected} was rejected"
            return _fault("drive", text, rejected, "stopPause asks for it again.")
        return None

    def _needed(self, goal: Corner) -> dict[str, Area]:
        found = self._on_way(self._here or goal, goal, "RELEASE")
        return {each.zone.zone_id: each for each in found}

    def _held(self) -> set[str]:
        """Return the zones that the robot is in, and has or had a release for."""
        requests = {id_: self.releases.of(id_) for id_ in self._inside}
        return {id_ for id_, each in requests.items() if each and each.granted}

    def _may_be_in(self, area: Area) -> bool:
        request = self.releases.of(area.zone.zone_id)
        if request is None:
            return False
        goes_on = area.zone.release_loss_behavior == "CONTINUE"
        return request.valid or (goes_on and request.entered and request.granted)

    def _mark_entered(self) -> None:
        """Note which requests are for zones that the robot is in."""
        for id_ in self._inside:
            if (request := self.releases.of(id_)) is not None:
                request.entered = True

    # Releases

    def _heard(self) -> None:
        self._entered_unasked = {
            id_ for id_ in self._entered_unasked if not self._may_be_in(self._inside[id_])
        }
        self._news.set()
        self._changed()

    def _lost(self, request: Request) -> None:
        """Stop: a grant has ended. If the robot may go on in the zone, it is only told."""
        area = self._inside.get(request.zone_id)
        goes_on = area is not None and area.zone.release_loss_behavior == "CONTINUE"
        if request.entered and goes_on:
            self.releases.tell(request)
        elif self._driver.driving:
            self._driver.reconsider()
        else:
            self.releases.settle()
        self._heard()

    # Positions

    def moved(self, here: Corner | None) -> None:
        """Take the position of the robot."""
        known, self._here = self._here is not None, here
        if here is None:
            self._checked = None
            if known and self._areas and self._driver.driving:
                text = "the position of the robot is lost, and zones are in force"
                self._driver.pause(Fault("lost", text, (), "Send stopPause or cancelOrder."))
            return
        if self._checked is None or math.dist(here, self._checked) >= self._free:
            self._look()

    def _look(self) -> None:
        """See which zones the robot touches."""
        if self._here is None:
            return
        self._checked, self._free = self._here, math.inf
        inside = dict[str, Area]()
        for area in self._areas:
            touched, margin = self._measure(area, *self._here)
            self._free = min(self._free, margin)
            if touched:
                inside[area.zone.zone_id] = area
        before, self._inside = self._inside, inside
        for id_, area in before.items():
            if id_ not in inside:
                self._leave(area)
        for id_, area in inside.items():
            if id_ not in before:
                self._enter(area)
        if before.keys() != inside.keys():
            self._changed()

    def _measure(self, area: Area, x: float, y: float) -> tuple[bool, float]:
        """Return whether a zone is touched, and how far the robot may move until that changes."""
        away = area.shape.box_distance(x, y)
        if away > self._radius:
            return False, away - self._radius
        border = area.shape.edge_distance(x, y)
        if area.shape.holds(x, y):
            return True, border + self._radius
        return border <= self._radius, abs(border - self._radius)

    def _enter(self, area: Area) -> None:
        zone = area.zone
        match zone.zone_type:
            case "BLOCKED":
                if self._driver.driving:
                    self._driver.pause()
            case "RELEASE":
                self._mark_entered()
                if self._driver.driving and not self._may_be_in(area):
                    self._entered_unasked.add(zone.zone_id)
                    self._driver.reconsider()
            case "SPEED_LIMIT":
                if self._driver.driving and self._pace > (zone.maximum_speed or math.inf):
                    self._driver.reconsider()
            case _:
                self._driver.zone_entered(zone)

    def _leave(self, area: Area) -> None:
        zone = area.zone
        self._entered_unasked.discard(zone.zone_id)
        if zone.zone_type == "ACTION":
            self._driver.zone_left(zone)
        elif zone.zone_type == "RELEASE":
            self._leave_release(zone.zone_id)

    def _leave_release(self, zone_id: str) -> None:
        ahead = self._needed(self._goal) if self._goal is not None else {}
        request = self.releases.of(zone_id)
        spent = {zone_id} if request is not None and not request.valid else set[str]()
        self.releases.keep({*ahead, *self._held()} - spent)
        if self._driver.driving and not all(map(self._may_be_in, ahead.values())):
            self._driver.reconsider()  # the way leads back into it
        self._news.set()

    def faults(self) -> list[Fault]:
        """Return the errors that last as long as the robot is where it must not be."""
        found = self.sets.faults()
        for id_, area in self._inside.items():
            if area.zone.zone_type == "BLOCKED":
                found.append(
                    _fault("blocked", f"the robot is in zone {id_}, which is BLOCKED", id_)
                )
            elif area.zone.zone_type == "RELEASE" and self._is_lost(area):
                hint = "Grant the request of zoneRequests, and the order goes on."
                found.append(_fault("release", f"the robot is in zone {id_} without a release", id_, hint))  # fmt: skip
        return found

    def _is_lost(self, area: Area) -> bool:
        request = self.releases.of(area.zone.zone_id)
        had = request is not None and (request.lost or request.status in ("REVOKED", "EXPIRED"))
        return not self._may_be_in(area) and bool(had or area.zone.zone_id in self._entered_unasked)


def _fault(kind: FaultKind, text: str, zone_id: str, hint: str = "") -> Fault:
    return Fault(kind, text, (("zoneId", zone_id),), hint)
