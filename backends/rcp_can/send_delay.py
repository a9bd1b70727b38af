"""How long a motor's set-points have been waiting to be sent."""

from __future__ import annotations

__all__ = ["SendDelay"]


class SendDelay:
    """Counts the time in which the bus took no frame, while the gateway itself ran.

    Where the whole gateway stood still, its frames waited too, and nothing is wrong with the bus.
    """

    def __init__(self) -> None:
        self.seconds = 0.0

    def advance(self, ran: float, lag: float) -> None:
        """Go on by the time that the gateway ran, s; frames have waited for `lag` s by the clock."""
        self.seconds = min(self.seconds + ran, lag)
