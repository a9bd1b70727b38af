"""Recorder: writes chosen resources, commands, events and e-stops to MCAP files."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from prometheus_client.core import Metric

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.access.acl import Rights
from rcp_kernel.config.role import Rule
from rcp_kernel.contract.metrics import counter
from rcp_kernel.features import (
    Feature,
    FeatureHost,
    FeatureKind,
    ServiceKey,
    StatusPart,
    SystemResource,
)
from rcp_kernel.features.incidents import INCIDENTS
from rcp_kernel.model import Operation, Resource
from rcp_recorder.config import BlackBoxConfig, RecorderConfig, check
from rcp_recorder.history import HISTORY, History, HistoryRequest
from rcp_recorder.messages import RecorderReply, RecorderRequest, RecordingState
from rcp_web.downloads import RECORDINGS

__all__ = [
    "BlackBoxConfig",
    "RecorderConfig",
    "RecorderReply",
    "RecorderRequest",
    "RecordingState",
    "rcp_features",
]

PATH = "/system/recorder"
_RESOURCE = Resource(
    name="service/recorder",
    description="Recordings whose resources you may read; starts, stops and pins recordings.",
    value=list[RecordingState],
    input=RecorderRequest,
    output=RecorderReply,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=({"start": {"name": "test-drive", "paths": ["/sensor/**"]}},),
    history=1,
)


_HISTORY = Resource(
    name="service/history",
    description="Returns what was recorded of a resource: samples, or minimum, maximum and mean of intervals.",
    input=HistoryRequest,
    output=dict[str, Any],
    operations=Operation.EXECUTE,
    examples=({"path": "/sensor/battery", "from": "-1h", "every": "1m"},),
)


def _make(config: RecorderConfig, host: FeatureHost) -> Feature:
    from rcp_recorder.downloads import Downloads
    from rcp_recorder.mcap_file import OpenFile
    from rcp_recorder.queries import Queries
    from rcp_recorder.recorder import Recorder
    from rcp_recorder.service import RecorderService
    from rcp_recorder.state import state
    from rcp_recorder.writer import Writer

    def changed() -> None:
        host.loop.call_soon_threadsafe(host.changed, PATH)

    writer = Writer(config, changed, OpenFile)
    recorder = Recorder(config, host, writer)
    service = RecorderService(recorder, host)
    queries = Queries()
    history = History(host, writer, service, queries)

    def status(_: Rights | None) -> StatusPart:
        return state(recorder)

    def metrics() -> Iterable[Metric]:
        counts = [
            (["queue"], writer.dropped),
            (["disk"], writer.lost),
            (["long"], recorder.counts.long),
            (["invalid"], recorder.counts.invalid),
            (["notices"], recorder.counts.notices),
        ]
        yield counter("rcp_recorder_missing", "Messages that were not recorded.", ("why",), counts)

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        recorder.open()
        try:
            yield
        finally:
            queries.close()
            await recorder.close()

    shown = SystemResource(
        resource=_RESOURCE,
        view=service.view,
        by_rights=True,
        pages=service.pages,
        execute=service.execute,
    )
    services: dict[ServiceKey[Any], Any] = {
        RECORDINGS: Downloads(writer.catalogue, service, history)
    }
    if recorder.black_box is not None:
        services[INCIDENTS] = recorder.black_box
    return Feature(
        resources=(shown, SystemResource(resource=_HISTORY, execute=history.execute)),
        services=services,
        on_event=recorder.heard,
        on_command=recorder.followed,
        halted=recorder.halted,
        rights_changed=service.forget,
        status=status,
        metrics=metrics,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Offer the recorder."""
    use = Rule(("discover", "read", "subscribe", "execute"), (PATH,))
    ask = Rule(("discover", "execute"), (HISTORY,))
    return [
        FeatureKind(
            "recorder",
            RecorderConfig,
            _make,
            __doc__ or "",
            needs=("mcap", "mcap_ros2", "zstandard"),
            check=check,
            grants={"operator": (use, ask), "agent": (ask,)},
        )
    ]
