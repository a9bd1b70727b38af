"""The composition root: each module builds one group of parts, from the groups below it."""

from rcp_gateway.composition.gateway import compose

__all__ = ["compose"]
