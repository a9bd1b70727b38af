"""Persistence: keyed values, a log protected by a hash chain, latches, and detection of damage.

`store.Store` is the interface, and keeps nothing; `disk_store.DiskStore` is SQLite. Imports nothing
of the gateway.
"""
