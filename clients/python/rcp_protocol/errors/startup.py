"""What stops a plugin, or the gateway, from coming up; never on the wire."""

from __future__ import annotations

__all__ = ["ConfigError", "NotReady", "PluginError", "StartupError"]


class StartupError(Exception):
    """Base of what stops a plugin, or the gateway, from coming up."""


class ConfigError(StartupError):
    """The configuration is wrong: only a change of it helps, so nothing is retried."""


class NotReady(StartupError):
    """The robot is not there yet: the supervisor tries again with backoff."""


class PluginError(StartupError):
    """A plugin breaks a rule: an async hook, a misspelt one, a name taken twice."""
