"""What the author of a backend provides to the stop suite, besides the backend suite."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager

from rcp_gateway.testing.backend._base import BackendTests

__all__ = ["StopRig"]


class StopRig(BackendTests):
    """The faults of a device that a test can bring about."""

    async def freeze_device(self) -> None:
        """Make the device neither respond nor accept anything, as if its processor had stopped."""
        raise NotImplementedError

    async def thaw_device(self) -> None:
        """Let the device continue."""
        raise NotImplementedError

    async def freeze_feedback(self) -> None:
        """Make the measurement of motion stop or repeat itself, while the link stays up."""
        raise NotImplementedError

    async def thaw_feedback(self) -> None:
        """Let it be measured again."""
        raise NotImplementedError

    def foreign_commander(self) -> AbstractAsyncContextManager[object]:
        """Let another commander control the device, past the gateway, while entered."""
        raise NotImplementedError

    def gives(self, name: str) -> bool:
        """Tell whether the author gave a fault."""
        own = getattr(type(self), name)
        return all(own is not getattr(base, name, None) for base in (StopRig, BackendTests))
