"""Hands that drive a robot from the Teleop page, on machines that may be slow."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import httpx
from playwright.async_api import Page, expect

from browser.input_helpers import push
from browser.robots import BOUND, speed, value

__all__ = ["KEYS", "PAD", "STICK", "Hand", "set_going"]


@dataclass(frozen=True)
class Hand:
    """What drives a robot: how it is pressed, and how it is let go of so that it can be pressed again."""

    press: Callable[[Page], Awaitable[object]]
    let_go: Callable[[Page], Awaitable[object]]


async def _turn_pad(page: Page) -> None:
    await page.evaluate("hold([-1, 0, 0, 0], true)")  # on its place: there is a wall somewhere


async def _let_pad_go(page: Page) -> None:
    await page.evaluate("hold([0, 0, 0, 0], false)")
    await expect(page.get_by_test_id("spent")).to_have_count(0)


async def _hold_keys(page: Page) -> None:
    await page.keyboard.down("Shift")
    await page.keyboard.down("ArrowLeft")


async def _let_keys_go(page: Page) -> None:
    await page.keyboard.up("ArrowLeft")
    await page.keyboard.up("Shift")


KEYS = Hand(_hold_keys, _let_keys_go)
PAD = Hand(_turn_pad, _let_pad_go)
STICK = Hand(push, lambda page: page.mouse.up())


async def set_going(page: Page, hand: Hand, robot: httpx.AsyncClient, odometry: str) -> None:
    """Press until the robot moves.

    A page or a gateway that stood still for a second has ended the drive, as it should: then a new press is due.
    """
    ended = page.locator("[data-code=held_up], [data-code=link_slow]")
    async with asyncio.timeout(BOUND):
        await hand.press(page)
        while speed(await value(robot, odometry)) < 0.05:
            if await ended.count():
                await hand.let_go(page)
                await hand.press(page)
            await asyncio.sleep(0.05)
