"""`rcp_protocol.wire`, under the name that plugins import."""

from rcp_protocol.wire import *  # noqa: F403 - all of it
from rcp_protocol.wire import __all__  # noqa: F401 - for `from … import *`
