"""Links with devices over a network: kept up, and with requests that end however the link ends.

For authors of backends, who give the connection and the messages; see docs/networked-backend.md.
"""

from __future__ import annotations

from rcp_links.channel import Channel, Connect
from rcp_links.json_lines import json_lines
from rcp_links.lateness import Lateness
from rcp_links.link import LinkHost, RequestLink, request_link
from rcp_links.messages import Messages
from rcp_links.timing import LinkTiming

__all__ = [
    "Channel",
    "Connect",
    "Lateness",
    "LinkHost",
    "LinkTiming",
    "Messages",
    "RequestLink",
    "json_lines",
    "request_link",
]
