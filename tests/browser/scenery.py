"""What a scene draws: the list of its layers, and the colours of its picture."""

from __future__ import annotations

import asyncio
import base64
from typing import Any

import pytest
from playwright.async_api import Locator

from browser.watched import Watched

__all__ = ["hues", "layer", "stands"]

_BOUND = 60.0  # s
_HUES = """
async ([png, x, y, half]) => {
  const bytes = Uint8Array.from(atob(png), (letter) => letter.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  const pen = new OffscreenCanvas(image.width, image.height).getContext("2d");
  pen.drawImage(image, 0, 0);
  const { data } = pen.getImageData(x - half, y - half, 2 * half, 2 * half);
  const found = { red: 0, green: 0, blue: 0 };
  for (let at = 0; at < data.length; at += 4) {
    const [r, g, b] = data.subarray(at, at + 3);
    if (r > g + 60 && r > b + 60) found.red += 1;
    if (g > r + 60 && g > b + 60) found.green += 1;
    if (b > r + 60 && b > g + 60) found.blue += 1;
  }
  return found;
}
"""


def layer(tab: Watched, kind: str, path: str) -> Locator:
    match = "=" if kind in ("frames", "link") else "$="
    return tab.page.locator(f"[data-testid=layer][data-layer={kind}][data-path{match}'{path}']")


async def stands(row: Locator, *place: float) -> None:
    """Wait until something is drawn at a place of the fixed frame."""
    attribute: Any = None
    try:
        async with asyncio.timeout(_BOUND):
            while True:
                attribute = await row.get_attribute("data-at")
                found = [float(word) for word in (attribute or "").split()]
                if len(found) == 3 and all(
                    abs(a - b) < 0.02 for a, b in zip(found, place, strict=True)
                ):
                    return
                await asyncio.sleep(0.05)
    except TimeoutError:
        pytest.fail(f"it stands at {attribute}, not at {place}")


async def hues(
    tab: Watched, x: float, y: float, middle: tuple[float, float], shot: bytes | None = None
) -> dict[str, int]:
    """Count the pixels of each hue near a place in the flat view, `middle` being its middle.

    The picture is that of a `shot` of the page, else of now.
    """
    scene = tab.page.get_by_test_id("scene")
    box = await scene.bounding_box()
    assert box is not None
    metre = box["height"] / 24
    png = base64.b64encode(shot or await tab.page.screenshot()).decode()
    at = (
        box["x"] + box["width"] / 2 + (x - middle[0]) * metre,
        box["y"] + box["height"] / 2 - (y - middle[1]) * metre,
    )
    return await tab.page.evaluate(_HUES, [png, round(at[0]), round(at[1]), round(0.4 * metre)])
