"""`rcp_protocol.values`, under the name that plugins import."""

from rcp_protocol.values import *  # noqa: F403 - all of it
from rcp_protocol.values import __all__  # noqa: F401 - for `from … import *`
