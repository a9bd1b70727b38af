"""The adapter suite of the test kit."""

from __future__ import annotations

import json
from typing import ClassVar

from websockets.exceptions import InvalidStatus

from plugins.foxglove.viewer import viewing
from rcp_foxglove import rcp_adapters
from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.testing import AdapterSuite


class TestFoxglove(AdapterSuite):
    kind: ClassVar[AdapterKind] = next(iter(rcp_adapters()))

    async def look(self, url: str, token: str) -> str:
        try:
            async with viewing(f"{url}/foxglove", token) as viewer:
                await viewer.op("serverInfo")
                await viewer.until(lambda: [m for m in viewer.texts if m["op"] == "advertise"])
                shown = [json.dumps(viewer.texts)]
                for number, topic in enumerate(list(viewer.channels)):
                    await viewer.subscribe(topic, number)
                    shown.append((await viewer.message(number))[1].decode())
                return "\n".join(shown)
        except InvalidStatus as error:
            return str(error)
