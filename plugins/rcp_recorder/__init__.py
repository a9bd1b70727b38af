"""Recorder: writes chosen resources, commands, events and e-stops to MCAP files."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from prometheus_client.core import Metric

from rcp_kernel.access.acl import Rights
from rcp_kernel.config.role import Rule
from rcp_kernel.contract.metrics import counter
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, StatusPart, SystemResource
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.model import Operation, Resource
from rcp_recorder.config import BlackBoxConfig, RecorderConfig, check
from rcp_recorder.messages import RecorderReply, RecorderRequest, RecordingState

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


def _make(config: RecorderConfig, host: FeatureHost) -> Feature:
    from rcp_recorder.mcap_file import OpenFile
    from rcp_recorder.recorder import Recorder
    from rcp_recorder.service import RecorderService
    from rcp_recorder.state import state
    from rcp_recorder.writer import Writer

    def changed() -> None:
        host.loop.call_soon_threadsafe(host.changed, PATH)

    writer = Writer(config, changed, OpenFile)
    recorder = Recorder(config, host, writer)
    service = RecorderService(recorder, host)

    def status(_: Rights | None) -> StatusPart:
        return state(recorder)

    def metrics() -> Iterable[Metric]:
        counts = [
            (["queue"], writer.dropped),
            (["disk"], writer.lost),
            (["long"], recorder.counts.long),
            (["invalid"], recorder.counts.invalid),
        ]
        yield counter("rcp_recorder_missing", "Messages that were not recorded.", ("why",), counts)

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        recorder.open()
        try:
            yield
        finally:
            await recorder.close()

    shown = SystemResource(
        resource=_RESOURCE,
        view=service.view,
        by_rights=True,
        pages=service.pages,
        execute=service.execute,
    )
    return Feature(
        resources=(shown,),
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
    return [
        FeatureKind(
            "recorder",
            RecorderConfig,
            _make,
            __doc__ or "",
            needs=("mcap",),
            check=check,
            grants={"operator": (use,)},
        )
    ]
