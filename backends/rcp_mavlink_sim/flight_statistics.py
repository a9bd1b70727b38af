"""How long the vehicle has flown and run in its life, in the parameters STAT_*."""

from __future__ import annotations

from rcp_mavlink_sim.parameters import Parameters

__all__ = ["FlightStatistics"]

_STORED = 30.0  # s: ArduPilot stores them that often


class FlightStatistics:
    """The counters; they begin at a boot."""

    def __init__(self, params: Parameters) -> None:
        self._params = params
        self._flown = self._run = self._left = 0.0
        self._params.set("STAT_BOOTCNT", params["STAT_BOOTCNT"] + 1)
        self._before = params["STAT_FLTTIME"], params["STAT_RUNTIME"]

    def step(self, seconds: float, *, flying: bool) -> None:
        """Count on."""
        self._run += seconds
        self._flown += seconds if flying else 0.0
        self._left += seconds
        if self._left >= _STORED:
            self._left = 0.0
            self._params.set("STAT_FLTTIME", int(self._before[0] + self._flown))
            self._params.set("STAT_RUNTIME", int(self._before[1] + self._run))
