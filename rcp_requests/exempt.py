"""Requests that stop or release something: they are neither counted nor refused."""

from __future__ import annotations

from collections.abc import Mapping

from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.features.resource import Releases
from rcp_kernel.wire import Request

__all__ = ["Exemptions"]


class Exemptions:
    """Knows them: e-stops, cancels, and what features say only releases something."""

    def __init__(self, releases: Mapping[str, Releases]) -> None:
        """`releases` are the predicates of features, by path."""
        self._releases = releases

    def __call__(self, request: Request) -> bool:
        """Return whether a request stops or releases something; such requests are never limited."""
        if request.type != "execute":
            return request.type == "cancel"
        if request.path == ESTOP:
            return True
        releases = self._releases.get(request.path or "")
        return releases is not None and releases(request)
