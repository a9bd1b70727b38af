"""Errors that stop a plugin or the gateway from starting; never on the wire."""

from __future__ import annotations

__all__ = ["ConfigError", "NotReady", "PluginError", "StartupError"]


class StartupError(Exception):
    """Base of errors that stop a plugin or the gateway from starting."""


class ConfigError(StartupError):
    """The configuration is wrong and must change, so nothing is retried."""


class NotReady(StartupError):
    """The robot is not available yet: the supervisor retries with backoff."""


class PluginError(StartupError):
    """A plugin breaks a rule: an async hook, a misspelt one, a name taken twice."""
