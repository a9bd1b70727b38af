"""Litestar controllers as the application of a `Mount`, refusing as the contract says.

`Application` serves them, `calls` describes them, and `read_query` reads the query of any request strictly.
"""
