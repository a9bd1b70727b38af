"""`rcp_protocol.model`, under the name that plugins import."""

from rcp_protocol.model import *  # noqa: F403 - all of it
from rcp_protocol.model import __all__  # noqa: F401 - for `from … import *`
