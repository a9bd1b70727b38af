"""A list that shows each reader its own is made in turns, for however many subscribers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterator
from contextlib import asynccontextmanager
from time import thread_time
from typing import Any

import msgspec
import pytest

from kernel.streaming.test_renewal import rules, until
from kernel.world import Client, Robot, prepared
from rcp_gateway.features import active
from rcp_gateway.server import Server, running
from rcp_kernel.config.file import parse
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.model import Resource
from rcp_kernel.sessions.session import Session

pytestmark = pytest.mark.anyio
BOARD = "/system/board"
LEVEL = "/tenant/alpha/sensor/level"
KEY = "driver-driver-driver"
SEEN, UNSEEN = ("/sensor/**", "/system/**"), ("/param/**", "/system/**")
ITEMS = 2_000
AT_ONCE = ITEMS // 4
_LEAST = 50e-6  # s that an item takes on any machine: a list takes at least 100 ms


class NoKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to configure."""


class Board:
    """Shows each reader a long list, and counts in which turn of the loop its items are made."""

    def __init__(self) -> None:
        self.turns = [0]
        self.items = ITEMS
        self.edition = 0
        self.slow = False
        self.by_rights = False

    def make(self, _table: NoKeys, host: FeatureHost) -> Feature:
        self.host = host
        resource = Resource(name="event/board", description="A board.", value=list[Any])
        shown = SystemResource(resource=resource, view=self.view, by_rights=self.by_rights)
        return Feature(resources=(shown,))

    def view(self, session: Session) -> Iterator[dict[str, Any]]:
        edition = self.edition
        for _ in range(self.items):
            self.turns[-1] += 1
            end = thread_time() + _LEAST
            while self.slow and thread_time() < end:
                pass
            yield {"edition": edition, "seen": bool(session.rights.mask(LEVEL))}

    def turn(self) -> None:
        self.turns.append(0)
        asyncio.get_running_loop().call_soon(self.turn)


@asynccontextmanager
async def boarded(board: Board) -> AsyncGenerator[Server]:
    robots: list[Robot] = []
    config = parse(rules(*SEEN), "test")
    made = prepared(config, robots)
    features = msgspec.structs.replace(config, features={**config.features, "board": True})
    kinds = {"board": FeatureKind("board", NoKeys, board.make)}
    made = msgspec.structs.replace(made, features=active(features, kinds, "test"))
    async with running(made) as server:
        yield server


async def subscribed(server: Server) -> tuple[Client, str]:
    client = Client(server.client_api, KEY)
    id_ = (await client.ask(type="subscribe", path=BOARD))["id"]
    await client.update(id_)
    return client, id_


async def test_a_long_list_is_made_in_turns_for_each_of_its_subscribers() -> None:
    board = Board()
    async with boarded(board) as server:
        clients = [await subscribed(server) for _ in range(3)]
        board.slow, board.turns = True, [0]
        asyncio.get_running_loop().call_soon(board.turn)
        board.host.changed(BOARD)
        for client, id_ in clients:
            assert len((await client.update(id_))["body"]) == ITEMS
        assert sum(board.turns) == len(clients) * ITEMS
        assert max(board.turns) <= AT_ONCE


async def test_a_change_while_a_list_is_made_has_it_made_once_more() -> None:
    board = Board()
    async with boarded(board) as server:
        client, id_ = await subscribed(server)
        board.slow, board.turns = True, [0]
        board.edition = 1
        board.host.changed(BOARD)
        await until(lambda: board.turns[-1])
        assert board.turns[-1] < ITEMS
        for board.edition in (2, 3):
            board.host.changed(BOARD)
        editions = [(await client.update(id_))["body"][-1]["edition"] for _ in range(2)]
        assert editions == [1, 3]


async def test_what_was_made_under_other_rights_is_not_sent() -> None:
    board = Board()
    board.items = 1
    async with boarded(board) as server:
        client, id_ = await subscribed(server)
        await asyncio.sleep(0)
        board.host.changed(BOARD)
        server.gateway.reconfigure(parse(rules(*UNSEEN), "test"))
        assert [item["seen"] for item in (await client.update(id_))["body"]] == [False]


async def test_a_list_that_depends_on_rights_only_is_made_once_for_those_with_equal_rights() -> (
    None
):
    board = Board()
    board.by_rights = True
    async with boarded(board) as server:
        clients = [await subscribed(server) for _ in range(3)]
        for board.edition in (1, 2):
            board.slow, board.turns = True, [0]
            asyncio.get_running_loop().call_soon(board.turn)
            board.host.changed(BOARD)
            for client, id_ in clients:
                body = (await client.update(id_))["body"]
                assert (len(body), body[0]["edition"]) == (ITEMS, board.edition)
            assert sum(board.turns) == ITEMS
            assert max(board.turns) <= AT_ONCE
