"""What `/system/status` tells of the recorder; nothing in it names a resource."""

from __future__ import annotations

from typing import Any

from rcp_kernel.features import StatusPart
from rcp_recorder.recorder import Recorder

__all__ = ["state"]


def state(recorder: Recorder) -> StatusPart:
    """Describe the recorder, degraded while it records nothing or has lost something.

    So it is while there are damaged files: somebody has to look after them.
    """
    writer, counts = recorder.writer, recorder.counts
    kept, damaged = writer.catalogue.files.values(), writer.catalogue.damaged.values()
    facts: dict[str, Any] = {
        "state": "stopped" if writer.trouble else "recording" if writer.open else "ready",
        "detail": writer.trouble,
        "files": len(kept),
        "bytes": sum(file.bytes for file in kept),
        "waiting_bytes": writer.waiting or None,
        "dropped": writer.dropped or None,
        "lost": writer.lost or None,
        "too_long": counts.long or None,
        "invalid": counts.invalid or None,
        "notices_dropped": counts.notices or None,
        "recovered": writer.catalogue.repaired or None,
        "damaged": len(damaged) or None,
        "damaged_bytes": sum(file.bytes for file in damaged) or None,
        "damaged_deleted": writer.catalogue.damaged_deleted or None,
        "deleted": writer.catalogue.deleted or None,
        "clock_set_back": writer.set_back or None,
        "clock_set_back_at": writer.set_back_at,
    }
    told = {key: value for key, value in facts.items() if value is not None}
    lost = writer.dropped > 0 or len(damaged) > 0
    return StatusPart({"recorder": told}, degraded=writer.trouble is not None or lost)
