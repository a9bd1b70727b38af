"""Actions of a zone: those that last as long as the robot is in it end with it, and hold nothing up."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from rcp_vda5050.config import ActionConfig, RobotConfig
from rcp_vda5050.link import Link, Running
from rcp_vda5050.performer import ActionState, Performer
from rcp_vda5050.zone_actions import ZoneActions
from rcp_vda5050.zone_messages import Vertex, Zone, ZoneAction

pytestmark = pytest.mark.anyio
CONFIG = RobotConfig(
    robot="/tenant/r1", token="t", manufacturer="acme", serial="r1", map="hall",
    actions={"hum": ActionConfig(path="action/hum"), "ring": ActionConfig(path="action/ring")},
)  # fmt: skip


class Gateway:
    """A link: `hum` runs until it is cancelled, which the robot confirms, and `ring` ends at once."""

    def __init__(self) -> None:
        self.running: dict[str, Running] = {}

    async def control(self) -> dict[str, Any] | None:
        return None

    def send(self, kind: str, path: str | None, _body: Any, **more: Any) -> Running:
        made = Running(cast("Link", self), None)
        if kind == "cancel":
            reply = {"status": "cancelled", "error": {"code": "cancelled", "message": "cancelled"}}
            self.running[more["command"]].hear(reply)
        elif path is not None and path.endswith("ring"):
            made.hear({"status": "completed"})
        else:
            made.hear({"status": "running", "command": "c1"})
            self.running["c1"] = made
        return made


def zone(during: str) -> Zone:
    return Zone(
        "bay", "ACTION", (Vertex(0, 0), Vertex(1, 0), Vertex(0, 1)),
        entry_actions=(ZoneAction("ring", "SINGLE"),),
        during_actions=(ZoneAction("hum", cast("Any", during)),),
        exit_actions=(ZoneAction("ring", "NONE"),),
    )  # fmt: skip


async def test_what_lasts_in_a_zone_ends_on_leaving_it() -> None:
    news = asyncio.Event()
    failed = list[ActionState]()
    resumed = asyncio.Event()
    resumed.set()
    performer = Performer(
        CONFIG,
        cast("Link", Gateway()),
        {},
        resumed,
        news.set,
        lambda state, _: failed.append(state),
    )
    actions = ZoneActions(performer, news.set)

    async def until(*statuses: str) -> None:
        async with asyncio.timeout(60):
            while tuple(each.status for each in actions.states.values()) != statuses:
                news.clear()
                await news.wait()

    actions.enter(zone("NONE"))
    assert not actions.blocks
    await until("FINISHED", "RUNNING")
    assert performer.awaited == []  # a HARD action of a node need not wait for it
    actions.leave(zone("NONE"))
    await until("FINISHED", "FINISHED", "FINISHED")
    assert len(set(actions.states)) == 3
    actions.clear()
    assert actions.states == {}
    actions.leave(zone("NONE"))  # it was left already
    assert actions.states == {}

    actions.enter(zone("SOFT"))
    assert actions.blocks
    await until("FINISHED", "RUNNING")
    assert actions.blocks
    for task in (*actions.tasks, *performer.running):  # a cancelled order
        task.cancel()
    await asyncio.gather(*actions.tasks, *performer.running, return_exceptions=True)
    actions.stop()
    await until("FINISHED", "FAILED")
    assert failed == []
    assert not actions.blocks
