"""Persistence: the store, and the audit log with its hash chain."""
