"""Panels of plugins: what their frame gets, what it cannot reach, and how far it may move a robot."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, FrameLocator, Page, expect

from browser.machines import Machines, key_of, machines, person
from browser.watched import signed_in
from configuration import backend, key, listener, table
from rcp_gateway.log import configure
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
BOUND = 60.0  # s
EXAMPLE = Path(__file__).parents[2] / "examples/rcp-panel-battery/rcp_panel_battery"
MANIFEST = """{"title": "Probe", "reads": [{"name": "pose"}], "writes": [{"name": "drive"}]}"""
INDEX = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Probe</title>
<body><p id="tried"></p><p id="got"></p><p id="answer"></p>
<button id="quiet">Quiet</button><button id="loud">Loud</button><script>"""
SCRIPT = """
const show = (id, text) => (document.getElementById(id).textContent = text);
const send = (message) => parent.postMessage({ rcp: 1, ...message }, "*");
const begin = () => setInterval(() => send({ type: "write", id: 1, name: "drive",
  value: { linear: { x: 0.25, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } } }), 100);
let timer = begin();
document.getElementById("loud").onclick = () => (timer = begin());
document.getElementById("quiet").onclick = () => (clearInterval(timer), show("tried", "quiet"));
addEventListener("message", ({ data }) => {
  if (data.type === "update") show("got", JSON.stringify(data.value.position));
  if (data.type === "reply" && data.id === 1) show("answer", data.error ? data.error.remedy : "taken");
  if (data.type === "ended") tried.push(data.error.code);
});
const tried = [];
const attempt = async (name, work) => {
  try { await work(); tried.push(`${name} worked`); } catch { tried.push(`${name} failed`); }
};
(async () => {
  await attempt("parent", () => parent.document.title);
  await attempt("storage", () => sessionStorage.getItem("rcp.token"));
  await attempt("cookie", () => document.cookie);
  await attempt("fetch", () => fetch("/rcp/v1/status"));
  await attempt("socket", () => new Promise((done, not) => {
    const socket = new WebSocket(location.href.replace("http", "ws"));
    socket.onopen = done; socket.onerror = not;
  }));
  await attempt("window", () => { if (!open("about:blank")) throw new Error("blocked"); });
  await attempt("top", () => { top.location.href = "about:blank"; });
  send({ type: "subscribe", name: "/tenant/alpha/sensor/pose" });
  send({ type: "subscribe", name: "pose" });
  setTimeout(() => show("tried", tried.join(", ")), 500);
})();
"""
LAYOUT = {
    "columns": [
        {
            "panels": [
                {
                    "kind": "plugin",
                    "plugin": "probe",
                    "paths": {
                        "pose": "/tenant/alpha/sensor/pose",
                        "drive": "/tenant/alpha/actuator/cmd_vel",
                    },
                }
            ]
        }
    ]
}


@pytest.fixture(scope="module")
async def site(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Machines]:
    """Run a gateway with two machines and a panel that tries whatever it can."""
    folder = tmp_path_factory.mktemp("probe")
    (folder / "panel.json").write_text(MANIFEST)
    (folder / "index.html").write_text(f"{INDEX}{SCRIPT}</script></body></html>")
    async with machines(panels={"probe": str(folder)}) as running:
        await keep(running.url, key_of("otto"), "Probe", LAYOUT)
        yield running


async def keep(url: str, secret: str, name: str, content: Any) -> None:
    body = {"do": "save", "name": name, "content": content}
    message = {"type": "execute", "path": "/system/layouts", "body": body}
    headers = {"authorization": f"Bearer {secret}"}
    async with httpx.AsyncClient(base_url=url, headers=headers, timeout=BOUND) as client:
        reply = (await client.post("/rcp/v1/messages", json=message)).json()
    assert reply["status"] == "completed", reply


async def until(found: Callable[[], bool]) -> None:
    """Wait for what a machine is told."""
    async with asyncio.timeout(BOUND):
        while True:
            if found():
                return
            await asyncio.sleep(0.02)


def speeds(got: list[tuple[str, Any]]) -> list[float]:
    return [value.linear.x for name, value in got if name == "actuator/cmd_vel"]


def frame_of(page: Page, title: str) -> FrameLocator:
    return page.frame_locator(f'iframe[title="{title}"]')


async def test_a_frame_gets_the_values_it_is_given_and_reaches_nothing_else(
    browser: Browser, site: Machines
) -> None:
    async with person(browser, site, "otto", "layout/otto/Probe") as tab:
        tab.expected += ["Content Security Policy", "sandbox", "policy: ", "WebSocket", "Unsafe"]
        frame = frame_of(tab.page, "Probe")
        await expect(frame.locator("#got")).to_contain_text('"x":0')
        tried = frame.locator("#tried")
        await expect(tried).not_to_be_empty()
        told = await tried.text_content()
        assert told is not None
        assert "worked" not in told, told
        assert told.count("failed") == 7, told
        assert "unknown_path" in told, told
        assert tab.page.url.startswith(site.url)


async def test_a_panel_drives_only_while_its_operator_allows_it_has_control_and_holds_on(
    browser: Browser, site: Machines
) -> None:
    async with person(browser, site, "otto", "layout/otto/Probe") as tab:
        tab.expected += ["Content Security Policy", "sandbox", "policy: ", "WebSocket", "Unsafe"]
        page = tab.page
        site.forget()
        answer = frame_of(page, "Probe").locator("#answer")
        await expect(answer).to_have_text("Press Allow writing.")
        await page.get_by_role("button", name="Allow writing").click()
        await expect(answer).to_have_text("Press Take control.")
        await page.get_by_role("button", name="Take control").click()
        await expect(answer).to_have_text("Hold the button Hold to drive.")
        assert speeds(site.one) == []
        hold = page.get_by_role("button", name="Hold to drive")
        await hold.focus()
        await page.keyboard.down("Space")
        await until(lambda: 0.25 in speeds(site.one))
        await page.keyboard.up("Space")
        await until(lambda: speeds(site.one)[-1] == 0)
        await expect(answer).to_have_text("Hold the button Hold to drive.")
        await page.keyboard.down("Space")
        site.forget()
        await until(lambda: 0.25 in speeds(site.one))
        # A frame that says nothing any more moves nothing any more, whoever holds the button.
        await frame_of(page, "Probe").locator("#quiet").dispatch_event("click")
        await until(lambda: speeds(site.one)[-1] == 0)
        await expect(hold).to_have_attribute("aria-pressed", "true")
        await page.keyboard.up("Space")


async def test_what_was_cut_moves_again_by_a_new_press_alone_whatever_the_frame_says(
    browser: Browser, site: Machines
) -> None:
    async with person(browser, site, "otto", "layout/otto/Probe") as tab:
        tab.expected += ["Content Security Policy", "sandbox", "policy: ", "WebSocket", "Unsafe"]
        page, frame = tab.page, frame_of(tab.page, "Probe")
        answer = frame.locator("#answer")
        await page.get_by_role("button", name="Allow writing").click()
        await page.get_by_role("button", name="Take control").click()
        await expect(answer).to_have_text("Hold the button Hold to drive.")
        hold = page.get_by_role("button", name="Hold to drive")
        await hold.focus()
        site.forget()
        site.by["alpha"].fails = True
        await page.keyboard.down("Space")
        await expect(page.get_by_text("the motor is jammed")).to_be_visible()
        site.by["alpha"].fails = False
        await expect(answer).to_have_text("Hold the button Hold to drive.")
        await frame.locator("#quiet").dispatch_event("click")
        await expect(frame.locator("#tried")).to_have_text("quiet")
        site.forget()
        await frame.locator("#loud").dispatch_event("click")
        await expect(hold).to_have_attribute("aria-pressed", "true")
        await expect(answer).to_have_text("Hold the button Hold to drive.")
        assert 0.25 not in speeds(site.one)
        await page.keyboard.up("Space")
        await page.keyboard.down("Space")
        await until(lambda: 0.25 in speeds(site.one))
        await page.keyboard.up("Space")


async def test_a_panel_that_would_write_something_else_asks_anew(
    browser: Browser, site: Machines
) -> None:
    async with person(browser, site, "otto", "layout/otto/Probe") as tab:
        tab.expected += ["Content Security Policy", "sandbox", "policy: ", "WebSocket", "Unsafe"]
        page = tab.page
        answer = frame_of(page, "Probe").locator("#answer")
        allow = page.get_by_role("button", name="Allow writing")
        await allow.click()
        await expect(answer).to_have_text("Press Take control.")
        await page.get_by_role("button", name="Edit").click()
        await page.get_by_role("button", name="Settings of probe").click()
        chosen = page.get_by_role("searchbox", name="Writes: drive")
        await chosen.fill("beta cmd_vel")
        await chosen.press("Enter")
        await expect(allow).to_be_visible()
        await expect(answer).to_have_text("Press Allow writing.")


async def test_the_example_shows_a_battery_and_sets_a_parameter(browser: Browser) -> None:
    secret = key_of("otto")
    text = (
        listener()
        + table("plugins.dashboard", panels={"battery": str(EXAMPLE)})
        + backend("rover", use="sim")
        + key("otto", secret, role="operator")
    )
    paths = {"battery": "/tenant/alpha/sensor/battery", "limit": "/tenant/alpha/param/speed_limit"}
    chosen = {"kind": "plugin", "plugin": "battery", "paths": paths}
    configure("error", "json")
    async with serve(parse(text, "test")) as served:
        url = next(facts["url"] for facts in served.server.status.transports if "url" in facts)
        await keep(url, secret, "Battery", {"columns": [{"panels": [chosen]}]})
        async with signed_in(browser, url, secret, "otto") as tab:
            await tab.open("layout/otto/Battery")
            frame = frame_of(tab.page, "Battery")
            await expect(frame.locator("#told")).to_contain_text(" %")
            await expect(frame.get_by_role("button", name="Set")).to_be_disabled()
            await tab.page.get_by_role("button", name="Allow writing").click()
            await tab.page.get_by_role("button", name="Take control").click()
            await frame.get_by_label("Limit").fill("0.5")
            await frame.get_by_role("button", name="Set").click()
            await expect(frame.locator("#answer")).to_have_text("set to 0.5")
            await tab.shoot("panel-of-a-plugin")
