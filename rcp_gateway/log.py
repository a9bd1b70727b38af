"""Logging: structlog, on a console for people, as JSON lines for machines, and as a resource."""

from __future__ import annotations

import logging
import sys
from collections import deque
from collections.abc import Callable, MutableMapping
from typing import Any, Literal

import structlog

from rcp_kernel.contract.caller import caller

__all__ = ["Recent", "configure"]

_KEPT = 100  # warnings that `/system/status` shows


_OWN_KEYS = frozenset(("timestamp", "level", "logger", "event", "exc_info", "exception"))


class Recent:
    """The last warnings and errors, and the callbacks for new ones."""

    def __init__(self) -> None:
        self.records: deque[dict[str, Any]] = deque(maxlen=_KEPT)
        self.on_record: list[Callable[[dict[str, Any]], None]] = []
        """Called with each, from any thread."""

    def __call__(
        self, _logger: Any, method: str, event: MutableMapping[str, Any]
    ) -> MutableMapping[str, Any]:
        """Keep a record of level warning and above; a structlog processor."""
        if method in ("warning", "error", "critical", "exception"):
            record = {
                "timestamp": event.get("timestamp"),
                "level": "error" if method == "exception" else method,
                "logger": event.get("logger") or "rcp",
                "message": str(event.get("event")),
                "facts": {
                    key: value if isinstance(value, (int, float, bool)) else str(value)
                    for key, value in event.items()
                    if value is not None and key not in _OWN_KEYS
                },
            }
            self.records.append(record)
            for callback in self.on_record:
                callback(record)
        return event


def configure(level: str = "info", format_: Literal["auto", "console", "json"] = "auto") -> Recent:
    """Set up logging for the process; return what keeps the recent warnings."""
    recent = Recent()
    console = format_ == "console" or (format_ == "auto" and sys.stderr.isatty())
    threshold = logging.getLevelNamesMapping()[level.upper()]
    # A pretty traceback takes the event loop most of a second, a plain one nothing.
    console_renderer = structlog.dev.ConsoleRenderer(
        exception_formatter=structlog.dev.plain_traceback
    )
    last: list[Any] = (
        [console_renderer]
        if console
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    )
    structlog.configure(
        processors=[
            _name,
            structlog.processors.add_log_level,
            _trace,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            recent,
            *last,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(threshold),
        logger_factory=_Named(sys.stderr),
        cache_logger_on_first_use=False,
    )
    # Libraries use the standard module: their warnings belong in the same log.
    logging.basicConfig(handlers=[_Handoff()], level=max(threshold, logging.WARNING), force=True)
    return recent


class _Named:
    def __init__(self, file: Any) -> None:
        self._make = structlog.PrintLoggerFactory(file)

    def __call__(self, *names: Any) -> Any:
        logger: Any = self._make()
        logger.name = names[0] if names else "rcp"
        return logger


def _name(logger: Any, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    event.setdefault("logger", getattr(logger, "name", "rcp"))
    return event


def _trace(_logger: Any, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Add the ids of the trace and the command in whose context something is logged."""
    now = caller()
    if now is not None:
        if now.command is not None:
            event.setdefault("command", now.command)
        if now.trace is not None:
            event.setdefault("trace_id", now.trace.id)
    return event


class _Handoff(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        log = structlog.get_logger(record.name)
        method = getattr(log, record.levelname.lower(), log.warning)
        method(record.getMessage(), exc_info=record.exc_info or None)
