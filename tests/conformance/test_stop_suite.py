"""The stop suite accepts no confirmation that comes too late."""

from __future__ import annotations

import pytest

from conformance.test_backend_sim import TestSimStops as SimStops

pytestmark = pytest.mark.anyio


class Impatient(SimStops):
    """The simulated rover, that nothing can confirm in time."""

    __test__ = False
    stop_within = 0.0

    async def at_rest(self) -> bool:
        return True

    async def _confirmed(self) -> None:
        """Be confirmed at some time after the request."""


class Patient(Impatient):
    stop_within = 60.0


async def test_a_confirmation_that_is_late_fails() -> None:
    with pytest.raises(AssertionError, match="confirmed after"):
        await Impatient()._confirmed_in_time()  # noqa: SLF001 # pyright: ignore[reportPrivateUsage]
    await Patient()._confirmed_in_time()  # noqa: SLF001 # pyright: ignore[reportPrivateUsage]
