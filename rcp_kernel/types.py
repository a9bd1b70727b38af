"""`rcp_protocol.types`, under the name that plugins import."""

from rcp_protocol.types import *  # noqa: F403 - all of it
from rcp_protocol.types import __all__  # noqa: F401 - for `from … import *`
