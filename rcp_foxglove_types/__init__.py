"""Values of the common kinds as the types that Foxglove's panels draw, without any connection.

For the adapter that speaks to viewers, and for recordings that viewers open. Nothing of the gateway
is imported.
"""

from __future__ import annotations

from rcp_foxglove_types.extension import Extension, extension, own_part
from rcp_foxglove_types.plain_fields import with_fields
from rcp_foxglove_types.well_known import WellKnown, fields_of, well_known

__all__ = [
    "Extension",
    "WellKnown",
    "extension",
    "fields_of",
    "own_part",
    "well_known",
    "with_fields",
]
