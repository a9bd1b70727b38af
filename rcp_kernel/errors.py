"""`rcp_protocol.errors`, under the name that plugins import."""

from rcp_protocol.errors import *  # noqa: F403 - all of it
from rcp_protocol.errors import __all__  # noqa: F401 - for `from … import *`
