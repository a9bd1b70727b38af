"""Litestar controllers as the application of a `Mount`, refusing as the contract says.

`Application` serves them.
"""
