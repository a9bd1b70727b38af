"""A router takes as many robots as a fleet has."""

from __future__ import annotations

import asyncio

import pytest

pytest.importorskip("zenoh")

import zenoh

from ports import free_port
from rcp_zenoh.session import configuration, opened

_MANY = 400  # beyond what shared memory allows on one machine


async def test_a_router_takes_the_sessions_of_hundreds_of_robots() -> None:
    endpoint = [f"tcp/127.0.0.1:{free_port()}"]
    async with opened(configuration("router", listen=endpoint), patient=False):
        sessions: list[zenoh.Session] = []
        try:
            for _ in range(_MANY):
                client = configuration("client", connect=endpoint)
                sessions.append(await asyncio.to_thread(zenoh.open, client))
            assert not any(session.is_closed() for session in sessions)
        finally:
            for session in sessions:
                await asyncio.to_thread(session.close)
