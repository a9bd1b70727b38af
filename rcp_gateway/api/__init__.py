"""The parts for transports and adapters, besides `ClientApi` and `rcp_web.asgi`.

A plugin that connects clients imports only public modules: of `rcp_gateway` `api`, `api.pages`,
`client_api`, `client_kinds`, `hookspecs` and `mounts`; of `rcp_kernel` `clock`, `errors`, `features`, `model`,
`types`, `values` and `wire`. These names are stable when what is behind them is rearranged.
"""

from __future__ import annotations

from rcp_conditions.fields import Field
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.certificates import require_certificates
from rcp_kernel.access.visibility import names_in
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import check_pattern
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.contract.paths import EVERYTHING as TOUCHES_EVERYTHING
from rcp_kernel.contract.peer import UNKNOWN as UNKNOWN_PEER
from rcp_kernel.contract.peer import Certificate, Peer, Serial
from rcp_kernel.contract.requests import QueuedRequest
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.sessions.outbound import SHARE as BACKLOG_SHARE
from rcp_kernel.sessions.outbound import Backlog, Outbound
from rcp_kernel.sessions.outbox import Wrap
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.substitutes import left_out
from rcp_kernel.tree.samples import Rendering, Sample
from rcp_protocol.structure import LONG as LONG_MESSAGE
from rcp_protocol.structure import check_structure
from rcp_requests.connections import Connection
from rcp_requests.discovery import Query
from rcp_requests.prompt_reply import PromptReply
from rcp_scheduling.shared_work import SharedWork
from rcp_scheduling.turns import Turns, at_once
from rcp_store.modes import others_may
from rcp_store.plugin_store import PluginStore

__all__ = [
    "BACKLOG_SHARE",
    "LONG_MESSAGE",
    "TOUCHES_EVERYTHING",
    "UNKNOWN_PEER",
    "Backlog",
    "Certificate",
    "Command",
    "Connection",
    "Field",
    "GatewayConfig",
    "Hello",
    "Outbound",
    "Peer",
    "PluginStore",
    "Principal",
    "PromptReply",
    "Query",
    "QueuedRequest",
    "Rendering",
    "Rights",
    "Sample",
    "Serial",
    "Session",
    "SharedWork",
    "Turns",
    "Wrap",
    "at_once",
    "check_pattern",
    "check_structure",
    "gateway_version",
    "left_out",
    "names_in",
    "others_may",
    "require_certificates",
    "to_internal_error",
]
