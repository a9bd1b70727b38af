"""The order in which a step of a command is kept, recorded and answered, and what is let go of at the end."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from kernel.world import World, kept_in, world_of
from rcp_kernel.sessions.command import Command, Record, command_id
from rcp_requests.command_rows import row_key
from rcp_requests.journal import CommandJournal

pytestmark = pytest.mark.anyio
GO = {"type": "execute", "path": "/tenant/alpha/action/go", "body": 4.0}


@dataclass
class Doing:
    """Whether a listener has nothing to do."""

    idle: bool = False


class Order:
    """Notes what becomes of each step, in the order in which it happens."""

    def __init__(self, journal: CommandJournal) -> None:
        self.noted: list[tuple[str, str]] = []
        self.state = Doing()
        journal.listeners.append(self)

    def kept(self, command: Command) -> None:
        self.noted.append(("kept", command.status))

    hears_feedback = True

    def on_command(self, command: Command, step: Record) -> None:
        assert command.history[-1] is step
        self.noted.append(("heard", step.status))
        if step.status == "accepted":
            command.followers.append(self.followed)

    def missed_step(self, command: Command, step: Record, error: Exception) -> None:
        raise error

    def followed(self, _command: Command, step: Record) -> None:
        self.noted.append(("followed", step.status))


@asynccontextmanager
async def watched(monkeypatch: pytest.MonkeyPatch) -> AsyncGenerator[tuple[World, Order]]:
    async with world_of() as world:
        journal = world.server.gateway.journal
        order = Order(journal)
        monkeypatch.setattr(world.server.gateway.store, "keeps", True)
        monkeypatch.setattr(journal, "keep", order.kept)
        yield world, order


async def test_each_step_is_kept_then_recorded_then_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with watched(monkeypatch) as (world, order):
        world.robot.release.set()
        assert (await world.client().ask(**GO))["status"] == "completed"
    assert order.noted == [
        ("kept", "accepted"),
        ("heard", "accepted"),
        ("followed", "accepted"),
        ("heard", "in_progress"),
        ("followed", "in_progress"),
        ("kept", "completed"),
        ("heard", "completed"),
        ("followed", "completed"),
    ]


async def test_an_idle_listener_is_not_called(monkeypatch: pytest.MonkeyPatch) -> None:
    async with watched(monkeypatch) as (world, order):
        order.state.idle = True
        world.robot.release.set()
        assert (await world.client().ask(**GO))["status"] == "completed"
    assert order.noted == [("kept", "accepted"), ("kept", "completed")]


async def test_commands_are_known_by_their_path_until_they_end(world: World) -> None:
    journal = world.server.gateway.journal
    first, second, other = (
        Command(name, f"/tenant/alpha/action/{path}", "operator", "alpha")
        for name, path in (("first", "go"), ("second", "go"), ("other", "cut_in"))
    )
    for command in (first, second, other):
        journal.write(command, Record("accepted", 1))
    assert journal.running_on(first.path) == (first, second)
    assert journal.running_on(other.path) == (other,)
    journal.write(first, Record("in_progress", 2))
    journal.write(first, Record("failed", 3))
    assert journal.running_on(first.path) == (second,)
    assert list(journal.running.values()) == [second, other]
    for command in (second, other):
        journal.write(command, Record("failed", 3))
        assert journal.running_on(command.path) == ()


async def test_a_finished_command_lets_go_of_its_task_and_of_who_asked(world: World) -> None:
    world.robot.release.set()
    reply: dict[str, Any] = await world.client().ask(**GO)
    command = world.server.gateway.journal.find(reply["command"])
    assert command is not None
    assert (command.task, command.requester, command.request) == (None, None, None)
    assert command.followers == []


async def test_requests_that_follow_one_command_are_answered_under_their_own_ids(
    world: World,
) -> None:
    client = world.client()
    ids = [client.send(**GO, idempotency_key="one") for _ in range(2)]
    await world.robot.started.get()
    world.robot.release.set()
    finals = [await client.final(id_) for id_ in ids]
    assert [final["id"] for final in finals] == ids
    assert len({final["command"] for final in finals}) == 1


def test_rows_of_the_same_time_are_near_each_other_in_the_store() -> None:
    keys = [row_key() for _ in range(3000)]
    assert len(set(keys)) == len(keys)
    assert sum(later < earlier for earlier, later in pairwise(keys)) <= 3


def test_ids_do_not_tell_how_many_commands_others_send() -> None:
    ids = [command_id() for _ in range(3000)]
    assert len(set(ids)) == len(ids)
    assert 1300 < sum(later < earlier for earlier, later in pairwise(ids)) < 1700


async def test_a_command_keeps_its_row_over_a_restart_until_it_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_requests.journal._KEPT", 2)
    text, ids = kept_in(tmp_path / "store.db"), list[str]()
    for _ in range(2):
        async with world_of(text) as world:
            world.robot.release.set()
            client = world.client()
            ids += [(await client.ask(**GO))["command"] for _ in range(2)]
            journal = world.server.gateway.journal
            assert [one.id for one in journal.every()] == ids[:-3:-1]
            await journal.committed()
    async with world_of(text) as world:
        assert {one.id for one in world.server.gateway.journal.every()} == set(ids[-2:])
