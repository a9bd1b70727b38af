"""The dashboard and what no robot should tell: every value, name and number that breaks a page which trusts them."""

from __future__ import annotations

import time
from typing import Any

import httpx
import msgspec
import pytest
from playwright.async_api import Browser, Page, expect

from browser.watched import log_in, watched
from browser.worlds import KEY, World, live, world
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
LONG = "x" * 10_000
MARKUP = "<img src=x onerror=window.ran=1><script>window.ran=1</script>"
TURNED = "\u202eDEPPOTS\u202c \u0007\u0000 \u2066\ufeff"
HUGE = 1e300
ODD: list[Any] = [
    None,
    True,
    HUGE,
    -HUGE,
    5e-324,
    2**63 - 1,
    float("nan"),
    float("inf"),
    LONG,
    MARKUP,
    TURNED,
    "",
    [],
    {},
    {"": {"": 1}, "a.b": 1, "a": {"b": 2}, "__proto__": 1, "constructor": 2, MARKUP: TURNED},
    {"position": None, "orientation": None},
    {"position": {"x": None, "y": "y", "z": HUGE}, "orientation": {"w": None}},
    {
        "position": {"x": float("nan"), "y": HUGE, "z": 0},
        "orientation": {"x": float("nan"), "y": 0, "z": HUGE, "w": 1},
    },
    {"position": [1, 2], "orientation": "up"},
    {"pose": {"pose": {"pose": 1}}},
    {"latitude": None, "longitude": 1e9},
    {"percentage": float("nan"), "voltage": None},
    {"percentage": -HUGE, "voltage": HUGE},
    {"mode": LONG, "state": {"a": [1]}},
    {"active": True, "message": LONG, "fault": None, "timestamp": "yesterday"},
    {"active": True, "message": {"a": MARKUP}, "fault": {}, "time": 5, "severity": []},
    {"active": True, "timestamp": HUGE, "message": TURNED},
    [[[[[[1]]]]]],
    [None] * 9,
    {"a": {"b": {"c": {"d": {"e": {"f": LONG}}}}}},
]


class Loose(msgspec.Struct):
    """Has the fields of a pose, of whatever type."""

    position: Any = None
    orientation: Any = None


class Picture(msgspec.Struct):
    """Has the fields of a picture, of whatever type."""

    width: Any = None
    height: Any = None
    encoding: Any = None
    data: Any = None


PICTURES: list[Any] = [
    {"width": 1e9, "height": 1e9, "encoding": "rgb8", "data": b""},
    {"width": None, "height": -1, "encoding": LONG, "data": "no"},
    {"width": 2, "height": 2, "encoding": "rgb8", "data": b"\x00" * 5},
    {"width": 2, "height": 2, "encoding": "32FC1", "data": b"\xff" * 16},
    {"width": 0, "height": 0, "encoding": "mono8", "data": b""},
    {"width": 4, "height": 4, "encoding": None, "data": b"\xff\xd8\xff"},
    None,
    LONG,
]
NAMES = [
    "sensor/pose",
    "sensor/battery",
    "sensor/mode",
    "sensor/joints",
    "sensor/position/global",
    "event/fault",
]
PAGES = {
    "": len(ODD),
    "explore?path=/tenant/alpha/sensor/pose": len(ODD),
    "explore": 8,
    "log": 8,
    "fleet": len(ODD),
    "camera": len(PICTURES),
    "plot?p=/tenant/alpha/sensor/pose%23position.x": 4,
    "commands": 1,
    "scene?robot=rover": len(ODD),
    "map": len(ODD),
}
"""Each page, and how much of what is odd it is shown."""
STATE = """
() => ({
  ran: window.ran,
  wide: [document.documentElement, document.querySelector("main")].some((one) => one.scrollWidth > one.clientWidth + 1),
  broken: document.querySelectorAll('[data-testid="broken"]').length,
  text: document.querySelector("main").innerText.length,
  turned: /[\\u202a-\\u202e\\u2066-\\u2069]/.test(document.querySelector("main").textContent),
})
"""


async def test_whatever_robots_tell_every_page_goes_on(browser: Browser) -> None:
    deep = "sensor/" + "/".join(["a"] * 200)
    declared = [
        *(live(name) for name in (*NAMES[1:], deep)),
        Resource(name="sensor/pose", description="Where.", value=Loose, live=True),
        Resource(name="sensor/picture", description="What.", value=Picture, live=True),
    ]
    async with (
        world({"rover": ("alpha", declared)}) as gateway,
        watched(browser, gateway.url) as tab,
    ):
        page = tab.page
        tab.expected.append("400 .*/dashboard/api/series")  # what is no number is not plotted
        await page.set_viewport_size({"width": 390, "height": 844})
        await tab.open()
        await log_in(page, KEY)
        await tab.connected()
        wrong: list[str] = []
        for name, much in PAGES.items():
            await tab.open(name)
            await expect(page.locator("main")).not_to_contain_text("Loading")
            seen = await tell(gateway, page, deep, much)
            for at, found in seen:
                if (
                    found["ran"]
                    or found["wide"]
                    or found["broken"]
                    or found["turned"]
                    or found["text"] < 20
                ):
                    wrong.append(f"{name or 'overview'} at {at!r:.80}: {found}")
            await tab.shoot(f"odd-{name.partition('?')[0] or 'overview'}")
        assert not wrong, "\n".join(wrong)


async def tell(gateway: World, page: Page, deep: str, much: int) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    for at, odd in enumerate(ODD[-much:]):
        gateway.publish("rover", "sensor/picture", PICTURES[at % len(PICTURES)], time.time_ns())
        for name in (*NAMES, deep):
            gateway.publish("rover", name, odd, time.time_ns())
        await page.wait_for_timeout(260)  # the cards take four a second
        found.append((odd, await page.evaluate(STATE)))
    return found


async def test_a_robot_whose_clock_is_ahead_is_old_when_it_falls_silent_and_plotted_when_it_is_set(
    browser: Browser,
) -> None:
    has = [live("sensor/battery", deadline=1.0), live("sensor/level")]
    async with world({"tank": ("alpha", has)}) as gateway, watched(browser, gateway.url) as tab:
        await tab.open()
        await log_in(tab.page, KEY)
        ahead = time.time_ns() + 3 * 3600 * 10**9
        gateway.publish("tank", "sensor/battery", {"percentage": 0.5}, ahead)
        await expect(tab.page.locator('[data-robot="tank"]')).to_contain_text("50 %")
        await expect(tab.page.locator('[data-robot="tank"]')).to_contain_text("stale")
        await tab.open("plot?p=/tenant/alpha/sensor/level%23")
        shown = tab.page.get_by_test_id("shown")
        gateway.publish("tank", "sensor/level", 1.5, ahead)
        await expect(shown).to_contain_text("1.5000")
        gateway.publish("tank", "sensor/level", 2.5)
        await expect(shown).to_contain_text("2.5000")


@pytest.mark.parametrize(
    "layout",
    [
        {},
        {"columns": "plots"},
        {
            "columns": [
                None,
                {"panels": [{"kind": "plot", "plots": {"0": "a"}, "seconds": "1e999"}]},
            ]
        },
        {
            "columns": [
                {
                    "panels": [
                        {
                            "kind": "plot",
                            "plots": [None, 5, ["/tenant/alpha/sensor/level#", 7], "x", [[]]],
                            "seconds": -1,
                        }
                    ]
                }
            ]
        },
        {
            "columns": [
                {"panels": [{"kind": "plot", "plots": [["/tenant/gone/sensor/level#x"] * 2]}]}
            ]
        },
    ],
)
async def test_a_layout_that_is_none_or_names_what_is_gone_leaves_the_plots_usable(
    browser: Browser, layout: dict[str, Any]
) -> None:
    has = [live("sensor/level")]
    headers = {"authorization": f"Bearer {KEY}"}
    async with world({"tank": ("alpha", has)}) as gateway, watched(browser, gateway.url) as tab:
        tab.expected.append("404")  # the series of what is gone
        await tab.open("plot")
        await log_in(tab.page, KEY)
        body = {"do": "save", "name": "Plots", "content": layout}
        message = {"type": "execute", "path": "/system/layouts", "body": body}
        async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as client:
            saved = await client.post("/rcp/v1/messages", json=message)
        assert saved.json()["status"] == "completed", saved.text
        await tab.page.get_by_role("button", name="Load").click()
        await tab.page.get_by_role("searchbox", name="Path").fill("/tenant/alpha/sensor/level")
        gateway.publish("tank", "sensor/level", 2.5)
        await expect(tab.page.get_by_role("heading", name="Plot", exact=True)).to_be_visible()
        await expect(tab.page.get_by_test_id("broken")).to_have_count(0)
        await tab.open("plot?add=/tenant/alpha/sensor/level%23")
        await expect(tab.page.get_by_test_id("shown").last).to_contain_text("2.5000")
