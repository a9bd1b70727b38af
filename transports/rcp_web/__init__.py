"""Litestar controllers as the application of a `Mount`, with errors as envelopes.

`Application` serves them, `calls` describes them, and `read_query` parses the query of any request
strictly.
"""
