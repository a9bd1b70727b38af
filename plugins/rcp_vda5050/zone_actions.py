"""Actions of zones of the type ACTION: on entering, while inside, and on leaving (3.0 section 6.4.1.1)."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable, Iterable

import structlog

from rcp_vda5050.messages import Action
from rcp_vda5050.performer import ENDED, STOPS_DRIVING, ActionState, Performer
from rcp_vda5050.zone_messages import Zone, ZoneAction

__all__ = ["ZoneActions"]

log = structlog.get_logger("rcp.vda5050")
_MOST = 200  # states that are remembered


class ZoneActions:
    """Those of one robot; `done` is called when a list of them has been performed."""

    def __init__(self, performer: Performer, done: Callable[[], None]) -> None:
        self._performer, self._done = performer, done
        self._ids = itertools.count(1)
        self._began = f"{time.time():.0f}"
        self.states: dict[str, ActionState] = {}
        self._of: dict[str, list[ActionState]] = {}
        """By zone, those since it was entered."""
        self._tasks: dict[asyncio.Task[None], list[ActionState]] = {}

    @property
    def tasks(self) -> list[asyncio.Task[None]]:
        """What is being performed."""
        return list(self._tasks)

    @property
    def blocks(self) -> bool:
        """Whether one of them waits or runs that the robot must stand still for."""
        return any(
            state.action.blocking_type in STOPS_DRIVING and state.status not in ENDED
            for states in self._tasks.values()
            for state in states
        )

    def enter(self, zone: Zone) -> None:
        """Perform the actions on entering a zone, and those while in it."""
        entry = self._made(zone, zone.entry_actions or (), lasts=False)
        during = self._made(zone, zone.during_actions or (), lasts=True)
        self._of[zone.zone_id] = entry + during
        self._start(entry + during)

    def leave(self, zone: Zone) -> None:
        """End the actions while in a zone that was entered, and perform those on leaving it."""
        if (states := self._of.pop(zone.zone_id, None)) is not None:
            self._performer.end_with_zone(states)
            self._start(self._made(zone, zone.exit_actions or (), lasts=False))

    def stop(self) -> None:
        """Fail what has not ended: its order was cancelled."""
        for state in self.states.values():
            if state.status not in ENDED:
                state.status = "FAILED"

    def clear(self) -> None:
        """Forget what has ended."""
        self.states = {id_: each for id_, each in self.states.items() if each.status not in ENDED}

    def _made(self, zone: Zone, given: Iterable[ZoneAction], *, lasts: bool) -> list[ActionState]:
        made = [
            ActionState(
                Action(
                    each.action_type,
                    f"{zone.zone_id}-{self._began}-{next(self._ids)}",
                    each.blocking_type,
                    each.action_parameters,
                ),
                "WAITING",
                ends_with_zone=lasts,
            )
            for each in given
        ]
        self.states |= {state.action.action_id: state for state in made}
        ended = [id_ for id_, each in self.states.items() if each.status in ENDED]
        for id_ in ended[: max(0, len(self.states) - _MOST)]:
            del self.states[id_]
        return made

    def _start(self, states: list[ActionState]) -> None:
        if states:
            task = asyncio.get_running_loop().create_task(self._performer.perform(states))
            self._tasks[task] = states
            task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        del self._tasks[task]
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("zone_actions_failed", exc_info=error)
        self._done()
