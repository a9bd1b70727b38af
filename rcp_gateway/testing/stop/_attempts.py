"""Everybody tries to move a robot under a latched e-stop, by every means that it offers."""

from __future__ import annotations

import asyncio
import itertools
from typing import TYPE_CHECKING

from rcp_gateway.testing._serve import OPERATOR
from rcp_gateway.testing.backend._base import Robot, kind_of_resource, offers
from rcp_kernel.model import Operation

if TYPE_CHECKING:
    from rcp_gateway.testing.stop._rig import StopRig

__all__ = ["Attempts"]

_REFUSED = frozenset(("estop_active", "adapter_unavailable"))
_PAUSE = 0.02  # s between two attempts


class Attempts:
    """Writes and executes of two clients, one after another, until cancelled."""

    def __init__(self, rig: StopRig, robot: Robot) -> None:
        self._rig, self._robot = rig, robot
        self.count = 0
        self.last = "nothing"

    async def run(self) -> None:
        """Try, and see that each attempt is refused.

        :raises AssertionError: one is not.
        """
        rig, robot = self._rig, self._robot
        clients = [robot.served.client(OPERATOR), rig.admin()]
        goals = rig.goals()
        barred = [
            resource
            for resource in robot.resources.values()
            if resource.energises or resource.moves or kind_of_resource(resource).value in _KINDS
            if resource.moves is not False or resource.energises
        ]
        for client, resource in itertools.cycle(itertools.product(clients, barred)):
            path = robot.path(resource.name)
            self.last = path
            if offers(resource, Operation.WRITE):
                body = rig.values(resource.name)[0]
                reply = await client.request("write", path, body=body)
            elif offers(resource, Operation.EXECUTE):
                goal = goals.get(resource.name)
                body = goal.good if goal is not None else next(iter(resource.examples), None)
                reply = await client.request("execute", path, body=body)
            else:
                continue
            self.count += 1
            assert "error" in reply, f"{path} was let through under an e-stop: {reply}"
            assert reply["error"]["code"] in _REFUSED, reply
            await asyncio.sleep(_PAUSE)


_KINDS = frozenset(("actuator", "action"))
