"""The service that records what happened to a robot before and after a moment."""

from __future__ import annotations

from typing import Protocol

from rcp_kernel.features.services import ServiceKey

__all__ = ["INCIDENTS", "IncidentService"]


class IncidentService(Protocol):
    """The black box of the robots."""

    def record(self, robot: str, reason: str) -> bool:
        """Write the last seconds of a robot and what follows; returns at once.

        `robot` is its path in the inventory. Return False if nothing of it is kept.
        """
        ...


INCIDENTS: ServiceKey[IncidentService] = ServiceKey("incidents")
