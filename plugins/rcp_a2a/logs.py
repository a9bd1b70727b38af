"""Log filter for the SDK: client errors are reported to clients, not to the operator."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["quieted"]

_LOGGERS = (
    "a2a.server.routes.jsonrpc_dispatcher",
    "a2a.compat.v0_3.jsonrpc_adapter",
    "a2a.compat.v0_3.rest_handler",
    "a2a.server.request_handlers.request_handler",
    "a2a.utils.error_handlers",
    "a2a.utils.version_validator",
    "a2a.server.tasks.inmemory_push_notification_config_store",
)
_OF_CLIENTS = ("Failed to parse request params", "Failed to validate base JSON-RPC request")


def _passes(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.ERROR and not record.msg.startswith(_OF_CLIENTS)


@contextmanager
def quieted() -> Generator[None]:
    """Suppress log records about malformed requests while entered."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    for logger in loggers:
        logger.addFilter(_passes)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(_passes)
