"""The public suite of adapters."""

from __future__ import annotations

import asyncio
import json

from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from rcp_gateway.testing import AdapterSuite
from rcp_rosbridge import ROSBRIDGE


class TestRosbridge(AdapterSuite):
    kind = ROSBRIDGE

    async def look(self, url: str, token: str) -> str:
        address = url.replace("http", "ws", 1) + "/rosbridge"
        headers = {"Authorization": f"Bearer {token}"}
        try:
            async with connect(address, additional_headers=headers, proxy=None) as socket:
                return await self._shown(socket)
        except WebSocketException as error:
            return str(error)

    async def _shown(self, socket: object) -> str:
        topics = json.dumps({"op": "call_service", "id": "1", "service": "/rosapi/topics"})
        shown = ""
        async with asyncio.timeout(60):
            await socket.send(topics)  # type: ignore[attr-defined]
            while '"1"' not in shown:
                shown += await socket.recv()  # type: ignore[attr-defined]
            for name in ("level", "secret"):
                topic = f"/sensor/{name}"
                if topic in shown:
                    await socket.send(json.dumps({"op": "subscribe", "topic": topic}))  # type: ignore[attr-defined]
                    shown += await socket.recv()  # type: ignore[attr-defined]
        return shown
