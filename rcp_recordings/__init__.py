"""Reads recordings: messages by time, values, tables, copies. Nothing of the gateway is imported.

Needs the extra `recorder`; only `names` and `query` do not.
"""
